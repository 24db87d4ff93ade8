"""`read_detections`: the boxes of all cameras from files in any format that the library reads."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from catfree.adapters.calibration_files._rig_json import read_scene_json
from catfree.adapters.datasets._uniform_json import read_uniform_json
from catfree.adapters.files._camera_names import (
    files_ending,
    is_numbered,
    names_of_files,
    natural_order,
    numbered_names,
    positions_of,
)
from catfree.adapters.files._documents import (
    IMAGE_SUFFIXES,
    StrPath,
    naming_file,
    read_json,
)
from catfree.adapters.files._text_rows import naming_line, read_csv, write_csv
from catfree.adapters.tables._coco import is_coco, read_coco
from catfree.adapters.tables._detections_table import (
    is_of_catfree,
    open_detections_table,
    optional_columns,
)
from catfree.adapters.tables._motchallenge import read_mot
from catfree.adapters.tables._parquet import read_parquet, reading, values_of
from catfree.errors import FileFormatError, InvalidInputError, quoted, shortened
from catfree.types import Clock, Detections
from catfree.types._validation import as_instances, as_integer, as_path, as_paths, shown_camera

# Files of a results folder; the last two if pictures are missing or videos start apart.
RESULT_BOXES, RESULT_SCENE = "detections.npz", "scene.json"
RESULT_SILENT, RESULT_OFFSETS = "missing_pictures.csv", "offsets.csv"
SUFFIXES = (".txt", ".csv", ".parquet", ".json", ".npz")

# Names of each column, the preferred first.
_FRAME = ("frame", "frame_id", "frame_number", "image_id")
_CAMERA = ("camera", "camera_id", "cam", "cam_id", "view")
_SCORE = ("score", "confidence", "conf")
_BOXES = (
    ("xyxy", ("x1", "y1", "x2", "y2")),
    ("xyxy", ("xmin", "ymin", "xmax", "ymax")),
    ("xywh", ("left", "top", "width", "height")),
    ("xywh", ("bb_left", "bb_top", "bb_width", "bb_height")),
    ("xywh", ("x", "y", "w", "h")),
)
_KNOWN = {*_FRAME, *_CAMERA, *_SCORE, *(name for _, names in _BOXES for name in names)}


@dataclass(frozen=True, eq=False)
class CameraBoxes:
    """Boxes of several cameras, as read from files.

    Attributes:
        detections: boxes of all cameras.
        camera_names: (C,) names; `detections.camera` indexes them.
        image_size: (C, 2) width and height in pixels, or None if the files do not state them.
        silent: (K, 2) frame and camera of missing pictures.
        offsets: (C,) the frame of each camera's video that shows frame 0; () if all are 0.
    """

    detections: Detections
    camera_names: tuple[str, ...]
    image_size: Int[np.ndarray, "cam 2"] | None = None
    silent: Int[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    offsets: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class _Part:
    """The boxes of one file, of a single camera if the file neither names nor numbers cameras.

    Camera numbers are `foreign` in the table of another program, which may count from 1.
    """

    detections: Detections
    names: tuple[str, ...] | None = None
    size: np.ndarray | None = None
    one_camera: bool = False
    foreign: bool = False


def read_detections(
    paths: StrPath | Sequence[StrPath],
    camera_names: Sequence[str] | None = None,
    *,
    frame_rate: float | int | None = None,
) -> tuple[Detections, tuple[str, ...]]:
    """Read boxes from a file, several files or a folder, in any format that the library reads.

    Formats: MOTChallenge text and COCO results (one file per camera), a CSV or Parquet table with
    the columns frame, camera, x1, y1, x2, y2 (or left, top, width, height) and score, a COCO data
    set, uniform JSON, and catfree's `.npz` files and result folders. A folder holds one file per
    camera, `CAMERA.txt` or `CAMERA/det/det.txt`, in natural order of their names.

    Args:
        paths: a file or folder, or the cameras' files in their order.
        camera_names: (C,) camera names in the order of the scene, to which the names in the files
            are matched; None for the order of the files. Camera numbers in a table are names if all
            of them are among `camera_names`, else positions, from 0. If none of them is 0,
            they are also names if `camera_names` is None or too short.
        frame_rate: frames per second of the clock, which keeps the files' start and kind; None to
            keep the files' clock, if any. For uniform JSON, the clock follows the file's `fps`,
            which counts instants, whatever their frame numbers.

    Returns:
        The boxes, and the names of their cameras: `camera_names` if given.

    Raises:
        InvalidInputError: if a file is missing, a box is invalid, or a camera of the files is not
            among `camera_names`.
        FileFormatError: if a file has another format.
    """
    boxes = read_camera_boxes(paths, camera_names, frame_rate=frame_rate)
    if camera_names is None:
        return boxes.detections, boxes.camera_names
    camera_index = positions_of(boxes.camera_names, camera_names)
    if camera_index is None:
        if not is_numbered(boxes.camera_names) or len(boxes.camera_names) > len(camera_names):
            raise InvalidInputError(
                f"The boxes are of the cameras {shortened(', '.join(boxes.camera_names))}, which "
                f"are not all among {shortened(', '.join(camera_names))}. Name both alike."
            )
        camera_index = list(range(len(boxes.camera_names)))
    camera = np.array(camera_index, np.int64)[boxes.detections.camera]
    return replace(boxes.detections, camera=camera), tuple(camera_names)


def read_camera_boxes(
    paths: StrPath | Sequence[StrPath],
    camera_names: Sequence[str] | None = None,
    *,
    frame_rate: float | int | None = None,
) -> CameraBoxes:
    """Read boxes as `read_detections` does, and keep the files' camera names and image sizes.

    Args:
        paths: as `read_detections`.
        camera_names: names that camera numbers refer to; camera names in the files are kept.
        frame_rate: as `read_detections`.

    Raises:
        CatFreeError: as `read_detections`.
    """
    names = () if camera_names is None else camera_names
    known = tuple(as_instances(names, str, "camera_names"))
    files = as_paths(paths, "paths")
    if not files:
        raise InvalidInputError("The list of files with boxes is empty. Name one per camera.")
    for path in files:
        if not path.exists():
            raise InvalidInputError(f"There is no file or folder {path} with boxes.")
    if len(files) == 1:
        files = _files_of(files[0])
    parts = _read_all(files, known)
    boxes = _joined(parts, files, known)
    if len(files) == 1:
        if missing := beside_results(files[0], RESULT_SILENT):
            boxes = replace(boxes, silent=read_missing_pictures(missing, boxes.camera_names))
        if began := beside_results(files[0], RESULT_OFFSETS):
            boxes = replace(boxes, offsets=_read_offsets(began, boxes.camera_names))
    if frame_rate is None:
        return boxes
    stated = boxes.detections.clock
    clock = Clock(frame_rate) if stated is None else replace(stated, frame_rate=frame_rate)
    return replace(boxes, detections=replace(boxes.detections, clock=clock))


def beside_results(boxes: Path, name: str) -> Path | None:
    """Return the file of this name beside the boxes of a results folder, if there is one."""
    path = boxes.with_name(name)
    return path if boxes.name == RESULT_BOXES and path.is_file() else None


def read_missing_pictures(path: StrPath, camera_names: Sequence[str]) -> Int[np.ndarray, "k 2"]:
    """Read which pictures are missing, for `silent` of `localize` and `shards`.

    Args:
        path: a CSV or Parquet table with the columns frame and camera.
        camera_names: (C,) names of the cameras; the column holds names or numbers from 0. Numbers
            are names only if all of them are among `camera_names`.

    Returns:
        (K, 2) frame and camera.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is not such a table, or names a camera that does not exist.
    """
    source = as_path(path, "path")
    camera_names = as_instances(camera_names, str, "camera_names")
    lines: Sequence[int]
    if source.suffix.lower() == ".parquet":
        columns = read_parquet(source, "missing pictures")
        table: dict[str, Any] = values_of(columns, columns.column_names, source)
        lines = range(1, len(columns) + 1)
    else:
        words = read_csv(source, "missing pictures")
        _plain_names(words.header, source)
        table, lines = words.columns(), words.lines
    plain = _plain_names(list(table), source)
    frame, camera = _first(_FRAME, plain), _first(_CAMERA, plain)
    if frame is None or camera is None:
        raise FileFormatError(
            f"{source} is not a table of missing pictures: it has no columns frame and camera."
        )
    cameras = [str(word).strip() for word in table[plain[camera]]]
    named = {name: index for index, name in enumerate(camera_names)}
    numbered = {str(index): index for index in range(len(camera_names))}
    only_numbers = set(cameras) <= numbered.keys() and not set(cameras) <= named.keys()
    camera_index = numbered if only_numbers else numbered | named
    for line, word in zip(lines, cameras, strict=True):
        if word not in camera_index:
            raise FileFormatError(
                f"{source}, line {line}: there is no camera {quoted(word)} among "
                f"{shortened(', '.join(camera_names))}."
            )
    with naming_line(source, lines):
        frames = as_integer(_numbers(table[plain[frame]], plain[frame]), "frame")
    return np.column_stack([frames, np.array([camera_index[word] for word in cameras], np.int64)])


def write_missing_pictures(
    path: StrPath, silent: Int[np.ndarray, "k 2"], camera_names: Sequence[str]
) -> Path:
    """Write a table that `read_missing_pictures` reads.

    Args:
        path: a CSV file.
        silent: (K, 2) frame and camera of missing pictures.
        camera_names: (C,) names of the cameras.

    Returns:
        The path.
    """
    rows = ([frame, camera_names[camera]] for frame, camera in silent.tolist())
    return write_csv(path, ("frame", "camera"), rows)


def _read_offsets(path: Path, camera_names: Sequence[str]) -> tuple[int, ...]:
    """Read the offset of each camera from a table that `write_offsets` wrote."""
    table = read_csv(path, "offsets")
    columns = table.columns()
    if not {"camera", "offset"} <= columns.keys():
        raise FileFormatError(f"{path} is not a table with the columns camera and offset.")
    with naming_line(path, table.lines):
        numbers = as_integer(_numbers(columns["offset"], "offset"), "offset")
    offsets = dict(zip(columns["camera"], numbers.tolist(), strict=True))
    return tuple(offsets.get(name, 0) for name in camera_names)


def write_offsets(path: StrPath, offsets: Sequence[int], camera_names: Sequence[str]) -> Path:
    """Write the offsets of the cameras whose first video frame is not frame 0.

    Args:
        path: a CSV file.
        offsets: (C,) the frame of each camera's video that shows frame 0.
        camera_names: (C,) names of the cameras.

    Returns:
        The path.
    """
    named = zip(camera_names, offsets, strict=False)  # cameras without boxes come last
    return write_csv(path, ("camera", "offset"), ([n, offset] for n, offset in named if offset))


def holds_boxes(path: StrPath) -> bool:
    """Return whether a path holds boxes rather than a video or images."""
    place = as_path(path, "path")
    if place.is_dir():
        if (place / RESULT_BOXES).is_file():  # pictures may be beside it
            return True
        try:
            return not has_images(place) and bool(_files_of(place))
        except InvalidInputError:
            return False
    return place.suffix.lower() in SUFFIXES


def has_images(folder: Path) -> bool:
    """Return whether a folder holds the images of a camera."""
    return bool(files_ending(folder, IMAGE_SUFFIXES))


def _files_of(source: Path) -> list[Path]:
    """List the files with boxes in a folder; for a file, the file itself."""
    if not source.is_dir():
        return [source]
    if (source / RESULT_BOXES).is_file():
        return [source / RESULT_BOXES]
    if files_ending(source, [".parquet"]):
        return [source]  # read as one table
    folders = [path for path in source.glob("[!.]*") if path.is_dir()]
    for files in (
        [path for folder in folders if (path := folder / "det" / "det.txt").is_file()],
        *(files_ending(source, [suffix]) for suffix in (".txt", ".csv", ".json")),
        [path for folder in folders for path in files_ending(folder, [".txt"])],
    ):
        if files:
            return sorted(files, key=lambda path: natural_order(str(path)))
    raise InvalidInputError(
        f"The folder {source} holds no boxes: neither *.txt, *.csv, *.json nor *.parquet, nor "
        "CAMERA/det/det.txt."
    )


def _read_all(files: list[Path], known: tuple[str, ...]) -> list[_Part]:
    """Read every file; a COCO data set describes the images of the results beside it."""
    if len(files) > 1 and all(path.suffix.lower() == ".json" for path in files):
        documents = [read_json(path, "boxes") for path in files]
        is_list = [isinstance(document, list) for document in documents]
        if is_list.count(False) == 1 and is_coco(documents[is_list.index(False)]):
            images = files.pop(is_list.index(False))
            return [_part_of_coco(path, images) for path in files]
    return [_read(path, known) for path in files]


def _read(path: Path, known: tuple[str, ...]) -> _Part:
    suffix = path.suffix.lower()
    if path.is_dir() and not files_ending(path, [".parquet"]):
        raise InvalidInputError(
            f"{path} is a folder, given together with other paths. Give one folder with the boxes "
            "of all cameras, or one file per camera."
        )
    if path.is_dir() or suffix == ".parquet":
        return _part_of_parquet(path, known)
    if suffix == ".npz":
        return _part_of_results(path)
    if suffix == ".json":
        if is_coco(read_json(path, "boxes")):
            return _part_of_coco(path, None)
        sequence = read_uniform_json(path)
        boxes, step = sequence.detections, np.diff(sequence.frames)
        if sequence.fps is not None and len(step):
            # `fps` counts instants, whose numbers may step by more than one.
            boxes = replace(boxes, clock=Clock(sequence.fps * float(np.median(step))))
        return _Part(boxes, sequence.camera_names, sequence.image_size)
    if suffix == ".csv":
        table = read_csv(path, "boxes")
        if not all(map(_is_number, table.header)):
            _plain_names(table.header, path)
            return _part_of_table(table.columns(), path, known, table.lines)
    if suffix not in SUFFIXES:
        raise FileFormatError(f"{path} is not a known file of boxes: {', '.join(SUFFIXES)}.")
    return _Part(read_mot(path).detections(), one_camera=True)


def _part_of_results(path: Path) -> _Part:
    """Read saved boxes, and the names and image sizes of their cameras from the scene of a run."""
    boxes, scene = Detections.load(path), path.with_name(RESULT_SCENE)
    if path.name != RESULT_BOXES or not scene.is_file():
        return _Part(boxes)
    known, names = read_scene_json(scene)
    if boxes.camera.max(initial=-1) >= known.rig.camera_count:
        return _Part(boxes)
    return _Part(boxes, names, np.asarray(known.rig.image_size))


def _part_of_coco(path: Path, images: Path | None) -> _Part:
    boxes = read_coco(path, images)
    return _Part(*boxes, one_camera=boxes.camera_names is None)


def _part_of_parquet(path: Path, known: tuple[str, ...]) -> _Part:
    if path.is_dir():
        opened = open_detections_table(path)
        with reading(path):
            table = opened.to_table()
    else:
        table = read_parquet(path, "boxes")
    plain = [name for name in table.column_names if "list" not in str(table[name].type)]
    # Camera numbers in catfree's own tables are positions, as in `Detections`.
    foreign = not is_of_catfree(table)
    part = _part_of_table(values_of(table, plain, path), path, known if foreign else ())
    options = optional_columns(table, path)
    with naming_file(path):
        detections = replace(part.detections, **options)
    return replace(part, detections=detections, foreign=foreign)


def _is_number(word: Any) -> bool:
    try:
        float(word)
    except (TypeError, ValueError):
        return False
    return True


def _is_index(word: str) -> bool:
    """Return whether a word is a whole number: "7" and "2.0" are, but "007" is a name."""
    if not (_is_number(word) and float(word).is_integer()):
        return False
    return "." in word or "e" in word.lower() or str(int(word)) == word


def _part_of_table(
    table: dict[str, Any], path: Path, known: tuple[str, ...], lines: Sequence[int] | None = None
) -> _Part:
    """Make detections from columns with usual names; numbers may be text.

    Errors name the line of a row if `lines` are given.
    """
    plain = _plain_names(list(table), path)
    frame = _first(_FRAME, plain)
    shapes = [(form, names) for form, names in _BOXES if set(names) <= set(plain)]
    if frame is None or not shapes:
        raise FileFormatError(
            f"{path} has the columns {shortened(', '.join(table))}; a table of boxes has frame, "
            "camera, x1, y1, x2, y2 (or left, top, width, height) and score. Rename them, or use "
            "cf.Detections.from_table."
        )
    form, box = shapes[0]
    camera, score = _first(_CAMERA, plain), _first(_SCORE, plain)
    wanted = [frame, *box] + ([] if score is None else [score])
    names = None
    with naming_line(path, lines):
        columns = {name: _numbers(table[plain[name]], plain[name]) for name in wanted}
        if camera is not None:
            columns[camera], names = _cameras(table[plain[camera]], plain[camera], known)
        detections = Detections.from_table(
            columns,
            frame=frame,
            camera=0 if camera is None else camera,
            box=box,
            form="xyxy" if form == "xyxy" else "xywh",
            score=score,
            camera_names=names,
        )
    return _Part(detections, names, one_camera=camera is None, foreign=True)


def _cameras(
    column: Any, name: str, known: tuple[str, ...]
) -> tuple[np.ndarray, tuple[str, ...] | None]:
    """Return a column of cameras as numbers, or as names with the distinct names in order."""
    cameras = np.asarray(column)
    words = ["" if word is None else str(word).strip() for word in cameras.tolist()]
    if "" in words:
        raise FileFormatError(f"{name}[{words.index('')}] is empty. Fill it.")
    names = set(words)
    if not names or not names <= set(known):
        if cameras.dtype.kind not in "OUST":
            return cameras, None
        if all(map(_is_index, names)):
            return _numbers(words, name), None
    return np.array(words), tuple(sorted(names, key=natural_order))


def _plain_names(names: Sequence[str], path: Path) -> dict[str, str]:
    """Map lower-case column names to the names in the file.

    Raises:
        FileFormatError: if a column that would be read occurs twice.
    """
    plain = [name.lower() for name in names]
    twice = [name for name, count in Counter(plain).items() if count > 1 and name in _KNOWN]
    if twice:
        raise FileFormatError(f"{path} has two columns {quoted(twice[0])}. Keep one of them.")
    return dict(zip(plain, names, strict=True))


def _first(wanted: Sequence[str], known: dict[str, str]) -> str | None:
    return next((name for name in wanted if name in known), None)


def _numbers(values: Any, name: str) -> np.ndarray:
    """Convert a column, possibly of text, to numbers; `Detections` rejects anything else."""
    array = np.asarray(values)
    if array.dtype.kind not in "OSU":
        return array
    try:
        if array.dtype.kind == "U":
            # A float holds only 53 bits of a whole number, too few for a time in nanoseconds.
            return array.astype(np.int64)
    except (ValueError, OverflowError):  # fractions, or no numbers at all
        pass
    try:
        return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        at = [_is_number(value) for value in values].index(False)
        raise FileFormatError(f"{name}[{at}] is {quoted(values[at])}, not a number.") from error


def _joined(parts: list[_Part], files: list[Path], known: tuple[str, ...]) -> CameraBoxes:
    """Join the boxes of files that hold one camera or several each."""
    alone = [part.one_camera for part in parts]
    if all(alone):
        names = _without_common_end(names_of_files(files))
        moved = [
            replace(part.detections, camera=np.full(len(part.detections), camera))
            for camera, part in enumerate(parts)
        ]
        sizes = [part.size for part in parts if part.size is not None]
        size = np.concatenate(sizes) if len(sizes) == len(parts) else None
        return CameraBoxes(Detections.concatenate(moved), tuple(names), size)
    if any(alone):
        raise InvalidInputError(
            f"{files[alone.index(True)]} holds the boxes of one camera, but "
            f"{files[alone.index(False)]} of several. Name files of one kind."
        )
    # A table without rows does not show whether it names its cameras.
    parts = [part for part in parts if part.names or len(part.detections)] or parts[:1]
    first = parts[0]
    if len({part.names is None for part in parts}) > 1:
        raise InvalidInputError(
            "Some of the files name their cameras, and others number them. Name them in all files."
        )
    names, size = first.names, first.size
    moved = [part.detections for part in parts]
    if len(parts) > 1:
        if names is not None:
            names, size, moved = _of_all_cameras(parts)
        _require_different_pictures(moved, names)
    detections = Detections.concatenate(moved)
    if names is None:
        count = int(detections.camera.max(initial=-1)) + 1
        if count <= len(known):
            names = known
        elif first.foreign and detections.camera.min() > 0:  # counted from 1: numbers are names
            numbers, place = np.unique(detections.camera, return_inverse=True)
            names, detections = tuple(map(str, numbers)), replace(detections, camera=place)
        else:
            names = numbered_names(count)
    return CameraBoxes(detections, names, size)


def _of_all_cameras(
    parts: list[_Part],
) -> tuple[tuple[str, ...], np.ndarray | None, list[Detections]]:
    """List the cameras that any file names, their sizes if known, and the boxes of each file."""
    place: dict[str, int] = {}
    sizes: dict[str, np.ndarray] = {}
    moved = []
    for part in parts:
        own = part.names or ()
        index = [place.setdefault(name, len(place)) for name in own]
        sizes |= {} if part.size is None else dict(zip(own, part.size, strict=True))
        moved.append(replace(part.detections, camera=np.array(index)[part.detections.camera]))
    size = np.array([sizes[name] for name in place]) if len(sizes) == len(place) else None
    return tuple(place), size, moved


def _require_different_pictures(parts: list[Detections], names: tuple[str, ...] | None) -> None:
    """Raise if several files hold boxes of one picture, as if each hour were numbered from 0."""
    pictures = [np.unique(np.stack([one.frame, one.camera], -1), axis=0) for one in parts]
    every, times = np.unique(np.concatenate(pictures), axis=0, return_counts=True)
    if (times > 1).any():
        frame, camera = every[times > 1][0].tolist()
        raise InvalidInputError(
            f"Several files have boxes of camera {shown_camera(camera, names)} in frame {frame}. "
            "Name each file once, and continue the frame numbers from one file to the next."
        )


def _without_common_end(names: list[str]) -> list[str]:
    """Shorten `C1/det/det`, `C2/det/det` to `C1`, `C2`."""
    while len(names) > 1 and all("/" in name for name in names):
        ends = {name.rpartition("/")[2] for name in names}
        short = [name.rpartition("/")[0] for name in names]
        if len(ends) > 1 or len(set(short)) < len(short):
            break
        names = short
    return names
