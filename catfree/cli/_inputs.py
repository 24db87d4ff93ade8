"""Open what the command line names: settings, videos, networks and ground truth.

Adapters are imported where a file is opened, so that `catfree --help` loads no video library.
"""

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np

from catfree.errors import FileFormatError, InvalidInputError, quoted

TRUTH_COLUMNS = ("frame", "id", "x", "y")


def settings_of(method: str) -> Any:
    """Return the settings of a named method."""
    from catfree.settings import Settings

    if method == "default":
        return Settings()
    return Settings.paper() if method == "paper" else Settings(method="evidence")


def require_files(videos: tuple[Path, ...], **others: Path | None) -> None:
    """Raise if a named file is missing, before anything slow begins.

    Args:
        videos: the cameras' videos.
        others: further files by option; None for an option that was not given.

    Raises:
        InvalidInputError: naming the first missing file.
    """
    _require_two(videos)
    for camera, path in enumerate(videos):
        if not path.exists():
            raise InvalidInputError(
                f"Camera {camera}: There is no video file or image folder {path}."
            )
    for option, path in others.items():
        if path is not None and not network_file(path).is_file():
            raise InvalidInputError(f"There is no file {path} (--{option}). Check the path.")


def network_file(path: Path) -> Path:
    """Return the file that an option names: its path, or the name of downloaded weights.

    Raises:
        InvalidInputError: if it is the name of weights that are not on this machine.
    """
    if path.exists():
        return path
    from catfree.adapters.weights import WEIGHTS, fetch_weights

    return fetch_weights(str(path), download=False) if str(path) in WEIGHTS else path


def _require_two(paths: tuple[Path, ...]) -> None:
    if len(paths) < 2:
        raise InvalidInputError(
            f"Locating people needs at least 2 videos, got {len(paths)}. Name one per camera."
        )


def open_videos(paths: tuple[Path, ...], **options: Any) -> Any:
    """Open the cameras' videos on a common clock.

    Raises:
        InvalidInputError: if there are fewer than two.
    """
    from catfree.adapters.video._synchronized_videos import SynchronizedVideos

    _require_two(paths)
    return SynchronizedVideos(paths, **options)


def open_detector(path: Path | None) -> Any:
    """Open the ONNX file, or the downloaded weights, of any supported detector."""
    from catfree.adapters.detectors._yolo_pose import YoloPoseOnnx
    from catfree.adapters.detectors._yolox import YoloxOnnx

    if path is None:
        return None
    path = network_file(path)
    try:
        return YoloPoseOnnx(path)
    except FileFormatError as not_pose:
        try:
            return YoloxOnnx(path)
        except FileFormatError:
            raise not_pose from None


def open_embedder(path: Path | None) -> Any:
    """Open the ONNX file, or the downloaded weights, of a re-identification network."""
    from catfree.adapters.embedders._reid import ReIdOnnx

    return None if path is None else ReIdOnnx(network_file(path))


def open_reconstructor(path: Path | None) -> Any:
    """Open the ONNX file of VGGT."""
    from catfree.adapters.reconstructors._vggt import VggtOnnx

    return None if path is None else VggtOnnx(path)


def open_scene(path: Path | None) -> tuple[Any, tuple[str, ...] | None]:
    """Read a saved scene, `.npz` or JSON, and the cameras' names if it has any."""
    from catfree.adapters.calibration_files._rig_json import read_scene

    return (None, None) if path is None else read_scene(path)


def read_truth(path: Path) -> np.ndarray:
    """Read rows (N, 4) of a CSV file with the columns frame, id (or track_id), x and y.

    Raises:
        FileFormatError: if a column is missing, or a line (which it names) has too few or too many
            columns or a value that is not a number.
    """
    from catfree.adapters.files._documents import read_text

    reader = csv.reader(io.StringIO(read_text(path, "ground truth")))
    try:
        words = ((reader.line_num, [word.strip() for word in row]) for row in reader)
        lines = [(line, row) for line, row in words if row not in ([], [""])]
    except csv.Error as error:
        raise FileFormatError(
            f"{path}: line {reader.line_num} is not CSV: {quoted(error)}."
        ) from error
    header = lines[0][1] if lines else []
    # Tracks of one run can serve as the truth of another.
    identity = "track_id" if "track_id" in header else "id"
    names = [identity if name == "id" else name for name in TRUTH_COLUMNS]
    missing = [name for name in names if name not in header]
    if missing:
        raise FileFormatError(
            f"{path} has no column {missing[0]!r}; ground truth is a CSV file with a header and "
            f"the columns {', '.join(TRUTH_COLUMNS)}."
        )
    if len(lines) == 1:
        raise FileFormatError(
            f"{path} has a header but no rows: there is no truth to compare with."
        )
    columns = [header.index(name) for name in names]
    rows = []
    for line, words in lines[1:]:
        if len(words) != len(header):
            raise FileFormatError(
                f"{path}: line {line} has {len(words)} columns instead of {len(header)}. Separate "
                "columns by commas and write decimals with a point."
            )
        rows.append(_truth_row([words[at] for at in columns], names, path, line))
    return np.array(rows)


def _truth_row(words: list[str], names: list[str], path: Path, line: int) -> list[float]:
    row = []
    for name, word in zip(names, words, strict=True):
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        whole = name not in ("x", "y")
        if not math.isfinite(value) or (whole and (value != round(value) or abs(value) >= 2**53)):
            kind = "a whole number" if whole else "a finite number"
            raise FileFormatError(f"{path}: {name} in line {line} is {quoted(word)}, not {kind}.")
        row.append(value)
    return row
