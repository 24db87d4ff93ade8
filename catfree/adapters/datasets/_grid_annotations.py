"""What WildTrack and MultiviewX share: a grid of people, boxes, camera poses and images."""

import dataclasses
import re
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from catfree.adapters.calibration_files._named_rig import FileCamera, rig_of, rotation_from_vector
from catfree.adapters.calibration_files._opencv_storage import read_matrices
from catfree.adapters.datasets._sequence import MultiViewSequence, require_people_in_front
from catfree.adapters.files._documents import (
    entry,
    is_whole,
    list_of,
    naming_file,
    numbers,
    read_json,
    whole_number,
)
from catfree.errors import FileFormatError, InvalidInputError
from catfree.types import Detections
from catfree.types._scene import metric_scene

InvalidBoxes = Literal["raise", "drop"]

_CORNERS = ("xmin", "ymin", "xmax", "ymax")


@dataclasses.dataclass(frozen=True)
class Grid:
    """A ground grid whose cells are numbered along x first.

    Attributes:
        columns: cells along x.
        rows: cells along y.
        cell: side of a cell in meters.
        origin: x, y in meters of cell 0.
        mirrored: whether y counts from the other side, as cells of a left-handed world do.
    """

    columns: int
    rows: int
    cell: float
    origin: tuple[float, float]
    mirrored: bool = False

    def position(self, cell: int) -> tuple[float, float]:
        """Return the x, y in meters of a cell."""
        x = self.origin[0] + self.cell * (cell % self.columns)
        y = self.origin[1] + self.cell * (cell // self.columns)
        return x, (self.area[2] + self.area[3] - y if self.mirrored else y)

    @property
    def area(self) -> tuple[float, float, float, float]:
        """The covered x_min, x_max, y_min, y_max in meters."""
        x, y = self.origin
        return (x, x + self.cell * self.columns, y, y + self.cell * self.rows)

    def lattice(self) -> np.ndarray:
        """Return (100, 2) positions in meters spread evenly over the grid."""
        x_min, x_max, y_min, y_max = self.area
        x, y = np.meshgrid(np.linspace(x_min, x_max, 10), np.linspace(y_min, y_max, 10))
        return np.column_stack([x.ravel(), y.ravel()])


@dataclasses.dataclass(frozen=True)
class GridDataSet:
    """Properties that all copies of a data set share.

    Attributes:
        name: name of the data set.
        camera_names: names in the order of viewNum; the image folders have the same names.
        grid: the annotated area.
        fps: annotated frames per second.
        test_from: first frame of the test split, the last tenth of the published frames.
    """

    name: str
    camera_names: tuple[str, ...]
    grid: Grid
    fps: float
    test_from: int


@dataclasses.dataclass(frozen=True)
class Annotations:
    """Annotated people: boxes with identities, and rows [frame, id, x, y] of true positions."""

    frames: np.ndarray
    detections: Detections
    identity: np.ndarray
    ground_truth: np.ndarray


def numbered_files(folder: Path, pattern: str) -> dict[int, Path]:
    """List the files of a folder whose stem is a number, by ascending number.

    Args:
        folder: where to look; a missing folder holds no files.
        pattern: regular expression that the suffix must match, without the dot: `json`.

    Raises:
        FileFormatError: if a number is too large to be exact.
    """
    name = re.compile(rf"(\d+)\.({pattern})", re.IGNORECASE)
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    matches = ((name.fullmatch(file.name), file) for file in files)
    numbered = sorted((int(match[1]), file) for match, file in matches if match)
    if numbered and not is_whole(numbered[-1][0]):
        raise FileFormatError(
            f"{numbered[-1][1]}: the number of this file is too large for a frame. Rename it."
        )
    return dict(numbered)


def read_annotations(
    files: dict[int, Path],
    data: GridDataSet,
    *,
    invalid_boxes: InvalidBoxes,
    drop_unseen: bool,
) -> Annotations:
    """Read one JSON file per frame: `[{personID, positionID, views: [{viewNum, xmin, ...}]}]`.

    Args:
        files: frame number to file.
        data: the data set whose cells positionID numbers.
        invalid_boxes: whether a box without area is an error or left out.
        drop_unseen: leave out people that no camera sees.

    Raises:
        InvalidInputError: naming file, frame, camera and index of a box without area or a
            position off the grid.
        FileFormatError: if a file does not have this form.
    """
    grid, camera_names = data.grid, data.camera_names
    boxes: list[tuple[int, int, int]] = []  # frame, camera, person
    corners: list[np.ndarray] = []
    truth: list[tuple[float, ...]] = []

    def add(person: Any, frame: int, where: str) -> None:
        identity, cell = (
            whole_number(entry(person, key, where), f"{key} of {where}")
            for key in ("personID", "positionID")
        )
        if not 0 <= cell < grid.columns * grid.rows:
            raise InvalidInputError(
                f"{where} has positionID {cell}, outside 0..{grid.columns * grid.rows - 1}."
            )
        is_seen = False
        for view in list_of(entry(person, "views", where), f"views of {where}"):
            camera = whole_number(entry(view, "viewNum", where), f"viewNum of {where}")
            if not 0 <= camera < len(camera_names):
                raise InvalidInputError(
                    f"{where} has viewNum {camera}, but there are {len(camera_names)} cameras "
                    "(counted from 0)."
                )
            box_name = f"the box of {where} in camera {camera_names[camera]}"
            values = [entry(view, key, box_name) for key in _CORNERS]
            box = numbers(values, (4,), box_name, finite=False)
            if (box == -1).all():
                continue
            if not (box[2] > box[0] and box[3] > box[1] and np.isfinite(box).all()):
                if invalid_boxes == "drop":
                    continue
                raise InvalidInputError(
                    f"{box_name} is {box.tolist()} as x1, y1, x2, y2, which has no area. Correct "
                    "it or pass invalid_boxes='drop'."
                )
            is_seen = True
            boxes.append((frame, camera, identity))
            corners.append(box)
        if is_seen or not drop_unseen:
            truth.append((frame, identity, *grid.position(cell)))

    for frame, source in files.items():
        people = read_json(source, f"annotations of frame {frame}")
        with naming_file(source):
            for at, person in enumerate(list_of(people, "the file")):
                add(person, frame, f"person {at} of frame {frame}")
    index = np.array(boxes, np.int64).reshape(-1, 3)
    return Annotations(
        frames=np.array(sorted(files), np.int64),
        detections=Detections(index[:, 0], index[:, 1], np.array(corners).reshape(-1, 4)),
        identity=index[:, 2],
        ground_truth=np.array(truth, np.float64).reshape(-1, 4),
    )


def read_pose(path: Path, camera: str) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Read R and t of a camera, named for messages, from a file with `rvec` and `tvec`."""
    pose = read_matrices(path, f"extrinsics of camera {camera}", {"rvec": (3,), "tvec": (3,)})
    with naming_file(path):
        return rotation_from_vector(pose["rvec"], "'rvec'"), pose["tvec"]


def grid_sequence(
    data: GridDataSet, people: Annotations, cameras: list[FileCamera], root: Path
) -> MultiViewSequence:
    """Make a sequence from a data set on a grid, in meters, z up, ground z = 0.

    Args:
        data: the data set.
        people: the annotations; if there are none, the images determine the frames.
        cameras: the cameras in meters.
        root: the data set's folder; images may be missing.

    Raises:
        InvalidInputError: if a camera is invalid, or all have most of the grid behind them.
    """
    with naming_file(root / "calibrations"):
        rig = rig_of(cameras)
        require_people_in_front(rig, data.grid.lattice())
    images = numbered_images(root, data)
    frames = people.frames if len(people.frames) else image_numbers(images)
    image_rows = tuple(tuple(map(files.get, frames.tolist())) for files in images)
    return MultiViewSequence(
        name=data.name,
        detections=people.detections,
        rig=rig,
        scene=metric_scene(rig),
        ground_truth=people.ground_truth,
        frames=frames,
        camera_names=data.camera_names,
        fps=data.fps,
        evaluation_area=data.grid.area,
        true_centres=np.asarray(rig.centers),
        images=image_rows if any(images) else (),
        identity=people.identity,
    )


def numbered_images(root: Path, data: GridDataSet) -> list[dict[int, Path]]:
    """List the images `Image_subsets/CAMERA/NUMBER.png|jpg` of each camera by their numbers."""
    folders = (root / "Image_subsets" / name for name in data.camera_names)
    return [numbered_files(folder, "png|jpe?g") for folder in folders]


def image_numbers(images: list[dict[int, Path]]) -> Int[np.ndarray, " f"]:
    """List the numbers of the images of any camera, ascending."""
    return np.array(sorted(set().union(*images)), np.int64)
