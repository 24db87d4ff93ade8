"""The folders of TrackEval: ground truth and tracks of one sequence, in the MOTChallenge layout."""

import configparser
import io
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from catfree.adapters.files._documents import StrPath, write_text_atomically
from catfree.adapters.tables._motchallenge import write_squares
from catfree.errors import InvalidInputError, quoted
from catfree.types import Tracks
from catfree.types._validation import as_integer, as_path, as_positive
from catfree.types._writing import make_folder


def write_trackeval(
    folder: StrPath,
    tracks: Tracks | ArrayLike,
    ground_truth: ArrayLike,
    frames: ArrayLike,
    *,
    sequence: str = "sequence",
    tracker: str = "catfree",
    threshold: float | int = 1.0,
) -> Path:
    """Write truth and tracks so that TrackEval's `MotChallenge2DBox` scores them on the ground.

    Positions become squares that overlap by half at the threshold (`write_mot_ground`). Run it with
    `GT_FOLDER=folder/gt`, `TRACKERS_FOLDER=folder/trackers` and `SKIP_SPLIT_FOL=True`. Further
    sequences and trackers may be written to the same folder, one after the other.

    Args:
        folder: created if it does not exist.
        tracks: tracks, or (M, 4) rows [frame, id, x, y].
        ground_truth: (G, 4) rows [frame, id, x, y].
        frames: (F,) all frame numbers of the sequence.
        sequence: name of the sequence.
        tracker: name of the tracker.
        threshold: largest distance of a match along an axis, in the unit of the positions.

    Returns:
        The folder.

    Raises:
        InvalidInputError: if a name cannot be a folder's, a frame is not among `frames`, or as
            `write_mot_ground`.
        WriteError: if the disk is full or not writable.
    """
    gate = as_positive(threshold, "threshold")
    for name in (sequence, tracker):
        taken = not isinstance(name, str) or name in ("", ".", "..")
        if taken or set(name) & set('/\\:\0,"\n'):
            raise InvalidInputError(f"{quoted(name)} cannot be the name of a folder.")
    root = as_path(folder, "folder")
    truth_folder = make_folder(root / "gt" / sequence / "gt")
    tracker_folder = make_folder(root / "trackers" / tracker / "data")
    write_squares(truth_folder / "gt.txt", ground_truth, frames, gate, "ground_truth")
    write_squares(tracker_folder / f"{sequence}.txt", tracks, frames, gate, "tracks")
    count = len(np.unique(as_integer(frames, "frames")))
    info = configparser.ConfigParser(interpolation=None)
    info.optionxform = str  # type: ignore[assignment,method-assign]
    info["Sequence"] = {"name": sequence, "seqLength": str(count)}
    text = io.StringIO()
    info.write(text)
    write_text_atomically(truth_folder.parent / "seqinfo.ini", text.getvalue())
    names = sorted(path.parent.name for path in (root / "gt").glob("*/seqinfo.ini"))
    maps = make_folder(root / "gt" / "seqmaps")
    write_text_atomically(maps / "MOT17-train.txt", "\n".join(["name", *names, ""]))
    return root
