"""Helpers of the track writers: rows with an identity, and frame numbers without gaps."""

import numpy as np
from jaxtyping import Int

from catfree.adapters.files._documents import StrPath
from catfree.errors import InvalidInputError
from catfree.types import Tracks
from catfree.types._sampling import common_step
from catfree.types._validation import require_instance


def tracked(tracks: Tracks, target: StrPath) -> Tracks:
    """Return the positions that belong to a track, for formats that require identities.

    Raises:
        InvalidInputError: naming the first position that is not finite, or if the argument is not
            `Tracks`.
    """
    require_instance(tracks, Tracks, "tracks")
    kept = tracks[tracks.track_id >= 0]
    bad = ~np.isfinite(np.asarray(kept.ground_xy)).all(axis=-1)
    if bad.any():
        at = int(np.argmax(bad))
        raise InvalidInputError(
            f"Cannot write {target}: the position of track {kept.track_id[at]} in frame "
            f"{kept.frame[at]} is not finite. Leave that row out."
        )
    return kept


def numbered_frames(frame: Int[np.ndarray, " m"]) -> tuple[Int[np.ndarray, " m"], int]:
    """Divide frame numbers by their common step, and return the step.

    Args:
        frame: (M,) numbers, for instance every fifth, as in WildTrack.
    """
    if not len(frame):
        return frame, 1
    step = common_step(frame)
    return (frame - frame.min() % step) // step, step
