"""Tracks as a data set of `movement`, the library that analyzes how animals and people move."""

from typing import Any

import numpy as np

from catfree.adapters.tables.tracks._tracked_rows import numbered_frames, tracked
from catfree.errors import InvalidInputError, needing
from catfree.types import Tracks

_MOST = 2**28  # numbers in the table of all people at all times


def to_movement(tracks: Tracks) -> Any:
    """Return a poses data set of `movement` with one keypoint, `ground`, per person.

    Individuals are named `id_TRACK`. Times are seconds from the first frame if the tracks have a
    clock, and frames otherwise; positions are ground coordinates in scene units, NaN where a person
    is not tracked; the confidence is `existence`.

    Args:
        tracks: positions without a track are left out.

    Returns:
        An `xarray.Dataset`.

    Raises:
        MissingDependencyError: if movement is not installed.
        InvalidInputError: if there are no tracks, or too many for a table of all people at all
            times.
    """
    with needing("Data sets of movement need movement: pip install movement."):
        from movement.io import load_poses  # pyright: ignore[reportMissingImports]
    kept = tracked(tracks, "a data set of movement")
    if not len(kept):
        raise InvalidInputError(
            "There are no tracks, and movement does not accept empty data sets."
        )
    frame, step = numbered_frames(kept.frame)
    frame = frame - frame.min()
    people, person_index = np.unique(kept.track_id, return_inverse=True)
    count = int(frame.max()) + 1
    if count * len(people) > _MOST:
        raise InvalidInputError(
            f"{len(people)} people at {count} times are too many for one table. Select a part of "
            "the tracks first."
        )
    position = np.full((count, 2, 1, len(people)), np.nan)
    position[frame, :, 0, person_index] = kept.ground_xy
    confidence = np.full((count, 1, len(people)), np.nan)
    if kept.existence is not None:
        confidence[frame, 0, person_index] = kept.existence
    return load_poses.from_numpy(
        position_array=position,
        confidence_array=confidence,
        individual_names=[f"id_{person}" for person in people.tolist()],
        keypoint_names=["ground"],
        fps=None if kept.clock is None else kept.clock.frame_rate / step,
        source_software="catfree",
    )
