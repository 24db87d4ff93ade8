"""WildTrack in the layout of its publishers: seven real cameras around a square in Zurich."""

from pathlib import Path

from catfree.adapters.calibration_files._named_rig import FileCamera, lens_coefficients
from catfree.adapters.calibration_files._opencv_storage import read_matrices
from catfree.adapters.datasets._grid_annotations import (
    Grid,
    GridDataSet,
    InvalidBoxes,
    grid_sequence,
    numbered_files,
    read_annotations,
    read_pose,
)
from catfree.adapters.datasets._sequence import MultiViewSequence
from catfree.adapters.files._documents import StrPath, require_folder
from catfree.types._validation import as_flag

# Folder C1 holds the images of the camera that calibration files call CVLab1, and so on.
CAMERAS = {
    "C1": "CVLab1",
    "C2": "CVLab2",
    "C3": "CVLab3",
    "C4": "CVLab4",
    "C5": "IDIAP1",
    "C6": "IDIAP2",
    "C7": "IDIAP3",
}
IMAGE_SIZE = (1920, 1080)
WILDTRACK = GridDataSet(
    name="WildTrack",
    camera_names=tuple(CAMERAS),
    grid=Grid(columns=480, rows=1440, cell=0.025, origin=(-3.0, -9.0)),
    fps=2.0,  # annotated frames; their numbers step by 5
    test_from=1800,
)
_METERS_PER_UNIT = 0.01  # the extrinsics are in centimeters


def read_wildtrack(
    folder: StrPath,
    *,
    undistorted: bool = True,
    invalid_boxes: InvalidBoxes = "raise",
    drop_unseen: bool = False,
) -> MultiViewSequence:
    """Read the WildTrack data set: calibration, annotations and image paths.

    The folder holds `calibrations/extrinsic/extr_*.xml`, `calibrations/intrinsic_zero` or
    `intrinsic_original/intr_*.xml`, `annotations_positions/*.json` and `Image_subsets/C1..C7`.
    Annotations and images may be missing. Frames keep their numbers 0, 5, 10, ...; they follow
    each other at 2 frames per second.

    Args:
        folder: the data set's folder.
        undistorted: True for the published images, which are undistorted; False for frames of the
            original videos, whose lens distortion the rig then includes.
        invalid_boxes: `raise` at an annotated box without area, or `drop` it.
        drop_unseen: leave out of the ground truth people that no camera sees, as the protocol of
            MVDet (Hou et al. 2020) does.

    Returns:
        The sequence in meters, z up, ground z = 0, with the annotated boxes as detections and the
        annotated people as `identity`. `frames` are the annotated ones, or those with images if
        there are no annotations.

    Raises:
        InvalidInputError: if a calibration file is missing, or a value is invalid; the message
            names the file.
        FileFormatError: if a file is malformed.

    Source:
        Chavdarova et al., WILDTRACK: A Multi-Camera HD Dataset for Dense Unscripted Pedestrian
        Detection, CVPR 2018.
    """
    root = require_folder(folder, "WildTrack")
    is_undistorted = as_flag(undistorted, "undistorted")
    cameras = _read_cameras(root / "calibrations", is_undistorted)
    files = numbered_files(root / "annotations_positions", "json")
    people = read_annotations(
        files, WILDTRACK, invalid_boxes=invalid_boxes, drop_unseen=drop_unseen
    )
    return grid_sequence(WILDTRACK, people, cameras, root)


def _read_cameras(folder: Path, undistorted: bool) -> list[FileCamera]:
    cameras = []
    for name, label in CAMERAS.items():
        kind = "intrinsic_zero" if undistorted else "intrinsic_original"
        inner = read_matrices(
            folder / kind / f"intr_{label}.xml",
            f"intrinsics of camera {name}",
            {"camera_matrix": (3, 3), "distortion_coefficients": (5,)},
        )
        lens = lens_coefficients(inner["distortion_coefficients"], f"camera {name}")
        R, t = read_pose(folder / "extrinsic" / f"extr_{label}.xml", name)
        t = t * _METERS_PER_UNIT
        cameras.append(FileCamera(inner["camera_matrix"], R, t, IMAGE_SIZE, lens))
    return cameras
