"""The `track1.txt` of the AI City Challenge: of 2025 (3-D boxes) and of 2023 and 2024 (images)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._documents import StrPath, write_text_atomically
from catfree.adapters.files._text_rows import read_rows
from catfree.adapters.tables.tracks._tracked_rows import tracked
from catfree.errors import InvalidInputError
from catfree.types import Detections, Tracks
from catfree.types._validation import as_count, as_integer, as_positive, require_shape
from catfree.types.results._tracks import supporting_boxes

_PERSON = 0  # class of people, 2025
_OF_BOXES, _OF_IMAGES = 11, 9  # columns


def write_ai_city_tracks(
    path: StrPath,
    tracks: Tracks,
    scene_id: int = 0,
    *,
    detections: Detections | None = None,
    camera_ids: Sequence[int] | None = None,
    person_height: float | int = 1.7,
    person_width: float | int = 0.6,
) -> Path:
    """Write tracks as a `track1.txt` of 2025 or, if detections are given, of 2023 and 2024.

    2025: `scene_id class_id object_id frame_id x y z width length height yaw`, one row per
    position, z at half the height, class 0 and yaw 0. 2023 and 2024: `camera_id obj_id frame_id
    xmin ymin width height xworld yworld`, one row per box that supports a position. Object ids
    count from 1; frame numbers are kept; the challenge counts them from 0.

    Args:
        path: the file.
        tracks: the tracks, in meters in the coordinates of `calibration.json`.
        scene_id: number of the scene (2025).
        detections: the detections that the tracks were made from, for the form of 2023 and 2024.
        camera_ids: (C,) numbers of the cameras; 1, 2, ... if None.
        person_height: height of the boxes in meters (2025).
        person_width: width and length of the boxes in meters (2025).

    Returns:
        The path.

    Raises:
        InvalidInputError: if a frame is negative, a position is not finite, the tracks are from
            other detections or do not say which boxes support them, or the folder does not exist.
        WriteError: if the disk is full or not writable.
    """
    kept = tracked(tracks, path)
    if (kept.frame < 0).any():
        raise InvalidInputError(
            f"Cannot write {path}: frame {kept.frame.min()} is negative, but frames count from 0."
        )
    xy = np.asarray(kept.ground_xy, np.float64)
    scene = as_count(scene_id, "scene_id")
    height = as_positive(person_height, "person_height")
    width = as_positive(person_width, "person_width")
    if detections is None:
        shape = f"{height / 2!r} {width!r} {width!r} {height!r} 0.0"
        lines = [
            f"{scene} {_PERSON} {person + 1} {frame} {x!r} {y!r} {shape}"
            for person, frame, (x, y) in zip(
                kept.track_id.tolist(), kept.frame.tolist(), xy.tolist(), strict=True
            )
        ]
        return write_text_atomically(path, "\n".join([*lines, ""]))
    row, camera, box = supporting_boxes(kept, detections)
    count = kept.support.shape[1]
    numbers = range(1, count + 1) if camera_ids is None else as_integer(camera_ids, "camera_ids")
    require_shape(numbers, (count,), "camera_ids")
    corner = np.floor(detections.box[box, :2])
    pixels = np.column_stack([corner, np.ceil(detections.box[box, 2:]) - corner]).astype(int)
    lines = []
    for at in np.lexsort((kept.frame[row], kept.track_id[row], camera)).tolist():
        person, frame = kept.track_id[row[at]] + 1, kept.frame[row[at]]
        (x, y), shape = xy[row[at]].tolist(), " ".join(map(str, pixels[at].tolist()))
        lines.append(f"{numbers[int(camera[at])]} {person} {frame} {shape} {x!r} {y!r}")
    return write_text_atomically(path, "\n".join([*lines, ""]))


def read_ai_city_tracks(path: StrPath, scene_id: int | None = None) -> Float[np.ndarray, "m 4"]:
    """Read the people of a `track1.txt`, or of a ground truth in its form.

    Args:
        path: the file, in the form of 2025 (11 columns) or of 2023 and 2024 (9 columns, where a
            position has one row per camera).
        scene_id: the sequence to read (2025); None if there is only one.

    Returns:
        (M, 4) rows [frame, id, x, y] in meters for `cf.evaluation`, sorted by frame and id.

    Raises:
        InvalidInputError: if there is no such file, a number is not finite, or there are several
            sequences and none is chosen.
        FileFormatError: naming the first line that has another form.
    """
    table, _ = read_rows(path, "tracks", (_OF_BOXES, _OF_IMAGES))
    if table.shape[1] == _OF_BOXES:
        table = table[table[:, 1] == _PERSON]
        scenes = [f"{one:g}" for one in np.unique(table[:, 0])]
        if scene_id is None and len(scenes) > 1:
            raise InvalidInputError(
                f"{path} holds the scenes {', '.join(scenes)}. Choose one as scene_id."
            )
        if scene_id is not None:
            table = table[table[:, 0] == as_count(scene_id, "scene_id")]
        positions = table[:, [3, 2, 4, 5]]
    else:
        positions = table[:, [2, 1, 7, 8]]
    _, first = np.unique(positions[:, :2], axis=0, return_index=True)
    return positions[first]
