"""True positions from files, with the protocol by which a benchmark scores them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from catfree.adapters.datasets._grid_annotations import numbered_files, read_annotations
from catfree.adapters.datasets._multiviewx import MULTIVIEWX, numbered_like_images
from catfree.adapters.datasets._uniform_json import read_uniform_json
from catfree.adapters.datasets._wildtrack import WILDTRACK
from catfree.adapters.files._documents import StrPath, read_json
from catfree.adapters.files._text_rows import read_csv
from catfree.errors import FileFormatError, InvalidInputError, quoted
from catfree.types._validation import as_path

Split = Literal["test", "train", "all"]
COLUMNS = ("frame", "id", "x", "y")

_FORM = f"ground truth is a CSV file with a header and the columns {', '.join(COLUMNS)}."
_DETECTION_GATE, _TRACKING_GATE = 0.5, 1.0  # meters


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """True positions and the protocol that scores them.

    Attributes:
        rows: (G, 4) float64 rows [frame, id, x, y] in meters.
        frames: (F,) ascending frames to score, including those without people; None for all frames
            of the truth or the tracks.
        area: x_min, x_max, y_min, y_max in meters of the scored area, or None for everywhere.
        protocol: what is scored, in words; empty for a file without a protocol.
        detection_gate: largest distance of a match for MODA in meters.
        tracking_gate: the same for MOTA and IDF1.
    """

    rows: Float[np.ndarray, "g 4"]
    frames: Int[np.ndarray, " f"] | None = None
    area: tuple[float, float, float, float] | None = None
    protocol: str = ""
    detection_gate: float = _DETECTION_GATE
    tracking_gate: float = _TRACKING_GATE

    @property
    def gates(self) -> tuple[float, float]:
        """Both distances."""
        return self.detection_gate, self.tracking_gate


def read_ground_truth(path: StrPath, split: Split = "test") -> GroundTruth:
    """Read true positions: CSV, uniform JSON, or the annotations of WildTrack or MultiviewX.

    Args:
        path: a CSV file with the columns frame, id (or track_id), x and y; a uniform JSON file;
            or the folder of WildTrack or MultiviewX, or of its `annotations_positions`.
        split: frames of WildTrack and MultiviewX: "test", the last tenth of the published frames
            (from 1800 and 360 on); "train", the earlier ones; or "all". Other files are read whole.

    Returns:
        Positions, frames and area. Those of WildTrack and MultiviewX are in the frames of
        reference of `read_wildtrack` and `read_multiviewx`, without people whom no camera sees.

    Raises:
        InvalidInputError: if there is no such file, or a value is invalid.
        FileFormatError: naming the line or place that has another form.

    Source:
        Split, area and 0.5 m for MODA as Hou et al. 2020 (MVDet), 1 m for tracking as Teepe et
        al. 2024 (EarlyBird).
    """
    source = as_path(path, "path")
    if not isinstance(split, str) or split not in ("test", "train", "all"):
        raise InvalidInputError(f"split is {quoted(split)}; it must be test, train or all.")
    if source.is_dir():
        return _read_grid(source, split)
    if source.suffix.lower() == ".json":
        sequence = read_uniform_json(source)
        if not len(sequence.ground_truth):
            raise InvalidInputError(f"{source} holds no true positions (gt) to compare with.")
        return GroundTruth(sequence.ground_truth, sequence.frames, sequence.evaluation_area)
    if source.suffix.lower() == ".parquet" and source.is_file():
        raise FileFormatError(f"{source} is a Parquet table; {_FORM}")
    return GroundTruth(_read_csv(source))


def _read_grid(source: Path, split: Split) -> GroundTruth:
    folder = source / "annotations_positions"
    folder = folder if folder.is_dir() else source
    files = numbered_files(folder, "json")
    if not files:
        raise InvalidInputError(
            f"{source} holds no annotations of WildTrack or MultiviewX "
            "(annotations_positions/NUMBER.json). For a results folder, give its tracks.csv."
        )
    # The first frames may show nobody; their files then list no views.
    cameras = next(filter(None, map(_view_count, files.values())), 0)
    data = {len(one.camera_names): one for one in (WILDTRACK, MULTIVIEWX)}.get(cameras)
    if data is None:
        raise FileFormatError(
            f"{folder} has annotations of {cameras} cameras; WildTrack has "
            f"{len(WILDTRACK.camera_names)} and MultiviewX {len(MULTIVIEWX.camera_names)}."
        )
    if data is MULTIVIEWX:
        files = numbered_like_images(files, folder.parent)
    people = read_annotations(files, data, invalid_boxes="drop", drop_unseen=True)
    frames = people.frames
    is_test = frames >= data.test_from
    split_frames = frames[{"test": is_test, "train": ~is_test, "all": frames >= 0}[split]]
    if not len(split_frames):
        raise InvalidInputError(
            f"{folder} has no annotations of the {split} split of {data.name}, whose test split "
            f"begins at frame {data.test_from}. Take the other split, or all."
        )
    rows = people.ground_truth[np.isin(people.ground_truth[:, 0], split_frames)]
    x_min, x_max, y_min, y_max = data.grid.area
    split_name = "all frames" if split == "all" else f"{split} split"
    protocol = (
        f"{data.name}, {split_name} ({len(split_frames)} frames, "
        f"{split_frames[0]} to {split_frames[-1]}), area "
        f"x {x_min:g} to {x_max:g} m, y {y_min:g} to {y_max:g} m, people seen by a camera; "
        f"MODA within {_DETECTION_GATE:g} m, MOTA and IDF1 within {_TRACKING_GATE:g} m"
    )
    return GroundTruth(rows, split_frames, data.grid.area, protocol)


def _view_count(file: Path) -> int:
    """Return how many views a file lists for its first person."""
    people = read_json(file, "annotations")
    first = people[0] if isinstance(people, list) and people else None
    views = first.get("views") if isinstance(first, dict) else None
    return len(views) if isinstance(views, list) else 0


def _read_csv(path: Path) -> np.ndarray:
    """Read rows (N, 4) of a CSV file with the columns frame, id (or track_id), x and y.

    Raises:
        FileFormatError: if a column is missing or occurs twice, or there are no rows; or naming the
            line with too few or too many columns, a value that is not a number, or a person already
            listed in the frame.
    """
    table = read_csv(path, "ground truth")
    header = [name.lower() for name in table.header]
    table = table._replace(header=header)
    # Tracks of one run can serve as the truth of another.
    identity = "track_id" if "track_id" in header else "id"
    names = [identity if name == "id" else name for name in COLUMNS]
    missing = [name for name in names if name not in header]
    if missing:
        raise FileFormatError(f"{path} has no column {missing[0]!r}; {_FORM}")
    if not table.rows:
        raise FileFormatError(
            f"{path} has a header but no rows: there is no truth to compare with."
        )
    columns = table.columns(once=names)
    rows = zip(table.lines, zip(*(columns[name] for name in names), strict=True), strict=True)
    truth = np.array([_row_of(words, names, path, line) for line, words in rows])
    line_of: dict[tuple[float, ...], int] = {}
    for line, (frame, person) in zip(table.lines, truth[:, :2].tolist(), strict=True):
        earlier = line_of.setdefault((frame, person), line)
        if person >= 0 and earlier != line:
            raise FileFormatError(
                f"{path}: lines {earlier} and {line} both say where person {person:.0f} is in "
                f"frame {frame:.0f}. Give every person one line per frame."
            )
    return truth


def _row_of(words: Sequence[str], names: list[str], path: Path, line: int) -> list[float]:
    row = []
    for name, word in zip(names, words, strict=True):
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        whole = name not in ("x", "y")
        exact = math.isfinite(value) and abs(value) < 2**63 and Decimal(word) == round(value)
        if not math.isfinite(value) or (whole and not exact):
            kind = "a whole number exact in double precision" if whole else "a finite number"
            raise FileFormatError(f"{path}: {name} in line {line} is {quoted(word)}, not {kind}.")
        row.append(value)
    return row
