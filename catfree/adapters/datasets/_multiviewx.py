"""MultiviewX in the layout of its publishers: six rendered cameras around a 25 x 16 m square."""

from pathlib import Path
from typing import Literal

import numpy as np

from catfree.adapters.calibration_files._named_rig import FileCamera
from catfree.adapters.calibration_files._opencv_storage import read_matrices
from catfree.adapters.datasets._grid_annotations import (
    Annotations,
    Grid,
    GridDataSet,
    InvalidBoxes,
    grid_sequence,
    image_numbers,
    numbered_files,
    numbered_images,
    read_annotations,
    read_pose,
)
from catfree.adapters.datasets._sequence import MultiViewSequence
from catfree.adapters.files._documents import StrPath, naming_file, require_folder
from catfree.adapters.files._text_rows import read_rows
from catfree.errors import FileFormatError, InvalidInputError
from catfree.types import Detections

IMAGE_SIZE = (1920, 1080)
MULTIVIEWX = GridDataSet(
    name="MultiviewX",
    camera_names=("C1", "C2", "C3", "C4", "C5", "C6"),
    grid=Grid(columns=1000, rows=640, cell=0.025, origin=(0.0, 0.0), mirrored=True),
    fps=2.0,
    test_from=360,
)
_DEPTH = 16.0  # meters of the square along y: the mirror maps y to 16 - y
_CORNER_POINTS = 9  # eight corners of a person's cuboid and the foot point


def read_multiviewx(
    folder: StrPath,
    *,
    boxes: Literal["annotations", "matchings"] | None = None,
    first_annotation: int | None = None,
    invalid_boxes: InvalidBoxes = "raise",
    drop_unseen: bool = False,
) -> MultiViewSequence:
    """Read the MultiviewX data set: calibration, annotations and image paths.

    The folder holds `calibrations/{intrinsic,extrinsic}/*.xml`, `annotations_positions/*.json` or
    `matchings/Camera*.txt` and `Camera*_3d.txt`, and `Image_subsets/C1..C6`. Annotations and
    images may be missing.

    The data set's world is left-handed, so its published extrinsics put everything at negative
    depth. Here y becomes 16 - y and the signs of R and t follow, which makes the world
    right-handed, z up, with positive depth. The published distortion (below 0.01 px, a residue of
    calibrating a rendered pinhole) is ignored.

    Args:
        folder: the data set's folder.
        boxes: the source of people: the annotations on the 2.5 cm grid, or the exact cuboids in
            `matchings`, whose identities are numbered in order of appearance. None takes the
            annotations if they exist.
        first_annotation: number of the annotation file (and of the frame in `matchings`) that
            belongs to image 0. None infers it: 1, as in the published sample, if the numbers
            match the images only with 1, or if there is no number 0; otherwise 0.
        invalid_boxes: `raise` at an annotated box without area, or `drop` it.
        drop_unseen: leave out of the ground truth people that no camera sees, as the protocol of
            MVDet (Hou et al. 2020) does.

    Returns:
        The sequence in meters, frames numbered like the images, with annotated boxes as
        detections and annotated people as `identity`.

    Raises:
        InvalidInputError: if a calibration file is missing, or a value is invalid; the message
            names the file.
        FileFormatError: if a file is malformed.

    Source:
        Hou, Zheng, Gould, Multiview Detection with Feature Perspective Transformation, ECCV 2020.
    """
    root = require_folder(folder, "MultiviewX")
    cameras = _read_cameras(root / "calibrations")
    files = numbered_files(root / "annotations_positions", "json")
    if boxes is None:
        has_matchings = (root / "matchings").is_dir()
        boxes = "matchings" if has_matchings and not files else "annotations"
    if boxes == "matchings":
        people = _read_matchings(root, first_annotation)
    else:
        people = read_annotations(
            numbered_like_images(files, root, first_annotation),
            MULTIVIEWX,
            invalid_boxes=invalid_boxes,
            drop_unseen=drop_unseen,
        )
    return grid_sequence(MULTIVIEWX, people, cameras, root)


def numbered_like_images(
    files: dict[int, Path], root: Path, first: int | None = None
) -> dict[int, Path]:
    """Number annotation files like the images; `first` as in `read_multiviewx`."""
    shift = _first_annotation_number(np.array(list(files)), root, first)
    return {number - shift: file for number, file in files.items()}


def _read_cameras(folder: Path) -> list[FileCamera]:
    cameras = []
    mirror, shift = np.diag([1.0, -1.0, 1.0]), np.array([0.0, _DEPTH, 0.0])
    center = np.array([MULTIVIEWX.grid.area[1] / 2, MULTIVIEWX.grid.area[3] / 2, 0.0])
    for camera, name in enumerate(MULTIVIEWX.camera_names, start=1):
        inner = read_matrices(
            folder / "intrinsic" / f"intr_Camera{camera}.xml",
            f"intrinsics of camera {name}",
            {"camera_matrix": (3, 3)},
        )
        path = folder / "extrinsic" / f"extr_Camera{camera}.xml"
        R, t = read_pose(path, name)
        if (R @ center + t)[2] >= 0:
            raise InvalidInputError(
                f"{path}: camera {name} has the square at positive depth, unlike the published "
                "left-handed calibration. Read a corrected calibration with another reader."
            )
        # x = R' X' + t' with X = F X' + c mirrored, and -x is the same pixel at positive depth.
        t = R @ mirror @ shift - t
        cameras.append(FileCamera(inner["camera_matrix"], -R @ mirror, t, IMAGE_SIZE))
    return cameras


def _first_annotation_number(annotated: np.ndarray, root: Path, first: int | None) -> int:
    """Find the annotation number of image 0; see `read_multiviewx`."""
    if first is not None:
        return first
    images = image_numbers(numbered_images(root, MULTIVIEWX))
    fits = [len(images) == 0 or bool(np.isin(annotated - shift, images).all()) for shift in (0, 1)]
    if fits[0] != fits[1]:
        return int(fits[1])
    return int(0 not in annotated)


def _read_matchings(root: Path, first: int | None) -> Annotations:
    """Read boxes around the projected cuboids, and exact foot positions."""
    folder = require_folder(root / "matchings", "MultiviewX matchings")
    rows, corners = [], []
    positions: dict[tuple[int, int], tuple[float, float]] = {}
    for camera, name in enumerate(MULTIVIEWX.camera_names):
        pixels_path = folder / f"Camera{camera + 1}.txt"
        points_path = folder / f"Camera{camera + 1}_3d.txt"
        pixels, points = (
            read_rows(
                path, f"{kind} points of camera {name}", (2 + axes * _CORNER_POINTS,), whole=2
            )[0]
            for path, kind, axes in ((pixels_path, "image", 2), (points_path, "world", 3))
        )
        if len(pixels) != len(points) or (pixels[:, :2] != points[:, :2]).any():
            raise FileFormatError(
                f"{pixels_path} and {points_path} do not list the same people in each row."
            )
        cuboid = pixels[:, 2:-2].reshape(-1, _CORNER_POINTS - 1, 2)
        corners.append(np.concatenate([cuboid.min(1), cuboid.max(1)], axis=-1))
        index = pixels[:, :2].astype(np.int64)
        rows.append(np.column_stack([index[:, 0], np.full(len(index), camera), index[:, 1]]))
        for key, foot in zip(map(tuple, index.tolist()), points[:, -3:-1], strict=True):
            positions[key] = (float(foot[0]), _DEPTH - float(foot[1]))
    table, box = np.concatenate(rows), np.concatenate(corners)
    shift = _first_annotation_number(np.unique(table[:, 0]), root, first)
    table[:, 0] -= shift
    order = np.lexsort((table[:, 2], table[:, 1], table[:, 0]))
    table, box = table[order], box[order]
    people = sorted(positions)  # by frame, then by the renderer's own number
    numbering = {person: at for at, person in enumerate(dict.fromkeys(p for _, p in people))}
    truth = [(f - shift, numbering[p], *positions[f, p]) for f, p in people]
    identity = np.array([numbering[p] for p in table[:, 2].tolist()], np.int64)
    with naming_file(folder):
        detections = Detections(table[:, 0], table[:, 1], box)
    return Annotations(
        frames=np.unique(table[:, 0]),
        detections=detections,
        identity=identity,
        ground_truth=np.array(truth, np.float64).reshape(-1, 4),
    )
