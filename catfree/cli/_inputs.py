"""Open inputs named on the command line: settings, videos, networks and scenes.

Adapters are imported when a file is opened, so that `catfree --help` loads no video library.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from catfree.errors import CatFreeError, FileFormatError, InvalidInputError, shortened

Unit = Literal["m", "cm", "mm", "ft", "arbitrary"]
Method = Literal["default", "paper", "evidence"]
VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".wmv")
TO_LOCALIZE = "Give the boxes to catfree localize."


def settings_of(method: str) -> Any:
    """Return the settings of a named method."""
    from catfree.settings import Settings

    return Settings.paper() if method == "paper" else Settings()


def require_files(
    videos: tuple[Path, ...], boxes_go: str = TO_LOCALIZE, **others: Path | None
) -> None:
    """Raise if a named file is missing or not a video, before any slow step.

    Args:
        videos: the cameras' videos.
        boxes_go: advice for boxes given as videos.
        others: further files by option; None for an option that was not given.

    Raises:
        InvalidInputError: naming the first missing file, or what the path is instead.
    """
    from catfree.types._validation import as_path

    options = {f"--{name}": path for name, path in others.items() if path is not None}
    cameras = {f"Camera {camera}": path for camera, path in enumerate(videos)}
    for name, path in (cameras | options).items():
        as_path(path, name)  # `Path.exists` raises an OSError for a name that is too long
    for path in videos:
        inside = _footage_in(path)
        if inside and inside != [path]:
            raise InvalidInputError(
                f"{path} is a folder of videos or image folders. Name these instead, one per "
                f"camera: {shortened(' '.join(map(str, inside)))}."
            )
    if all(path.exists() for path in videos) and are_boxes(videos):
        raise InvalidInputError(f"{_like_boxes(videos[0])}, not like a video. {boxes_go}")
    for camera, path in cameras.items():
        if not path.exists():
            raise InvalidInputError(f"{camera}: There is no video file or image folder {path}.")
    _require_two(videos)
    for option, path in options.items():
        exists = path.exists() if option == "--scene" else network_file(path).is_file()
        if not exists:
            raise InvalidInputError(f"There is no file {path} ({option}). Check the path.")


def require_offset(largest: int) -> None:
    """Raise if the largest offset to search is negative, before any slow step."""
    from catfree.types._validation import as_count

    as_count(largest, "--max-offset", least=0)


def require_other_folder(out: Path, boxes: tuple[Path, ...]) -> None:
    """Raise if results would be written into the folder of their boxes.

    Raises:
        InvalidInputError: naming the folder.
    """
    folders = (path if os.path.isdir(path) else path.parent for path in boxes)
    if os.path.realpath(out) in map(os.path.realpath, folders):
        raise InvalidInputError(
            f"--out is {out}, the folder of the boxes, which would be replaced by those of the "
            "results or read together with them. Name another folder."
        )


@contextlib.contextmanager
def folder_of_results(out: Path) -> Iterator[None]:
    """Create the results folder before the work; remove it if nothing is written there.

    Raises:
        InvalidInputError: if no folder can have this path.
        WriteError: if the folder cannot be created.
    """
    from catfree.types._writing import make_folder

    is_new = not os.path.exists(out)
    make_folder(out)
    try:
        yield
    finally:
        if is_new:
            with contextlib.suppress(OSError):  # it is not empty
                out.rmdir()


def _footage_in(path: Path) -> list[Path]:
    """List the path if it is a video or image folder, otherwise the videos and folders in it."""
    from catfree.adapters.datasets._detection_files import has_images

    def is_footage(one: Path) -> bool:
        return one.suffix.lower() in VIDEO_SUFFIXES if not one.is_dir() else has_images(one)

    if is_footage(path):
        return [path]
    return sorted(filter(is_footage, path.iterdir())) if path.is_dir() else []


def network_file(path: Path) -> Path:
    """Return the file that an option names: its path, or the name of downloaded weights.

    Raises:
        InvalidInputError: if it names weights that are not on this machine.
    """
    if os.path.exists(path):
        return path
    from catfree.adapters.weights._fetch_weights import fetch_weights
    from catfree.adapters.weights._weights_table import WEIGHTS

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
    return SynchronizedVideos(paths, fewest_cameras=2, **options)


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


def open_scene(
    path: Path | None, unit: Unit = "m", image_size: tuple[int, int] | None = None
) -> tuple[Any, tuple[str, ...] | None]:
    """Read cameras and ground in any format, and the cameras' names if there are any.

    Raises:
        CatFreeError: if there is no calibration, or a unit without a calibration.
    """
    from catfree.adapters.datasets._scene_files import read_scene

    if path is None:
        if unit != "m":
            raise InvalidInputError(
                f"--unit {unit} is the unit of a --scene, and none is given. Cameras that are "
                "found from people are in meters. Leave out --unit."
            )
        return None, None
    return read_scene(path, unit=unit, image_size=image_size)


def open_anchors(path: Path | None) -> tuple[Any, ...]:
    """Read anchors, the known measurements of the site."""
    from catfree.calibration import read_anchors

    return () if path is None else read_anchors(path)


def open_boxes(
    paths: tuple[Path, ...],
    frame_rate: float | int | None = None,
    image_size: tuple[int, int] | None = None,
    silent: Path | None = None,
    camera_names: tuple[str, ...] | None = None,
) -> Any:
    """Read the boxes, names and image sizes of all cameras.

    Args:
        paths: files of boxes, or one folder.
        frame_rate: frames per second, if known.
        image_size: width and height in pixels of all images, if known.
        silent: table of missing pictures, if there are any.
        camera_names: (C,) names of the scene's cameras, if known.

    Raises:
        CatFreeError: if these are not boxes, naming the command that takes such files.
    """
    from dataclasses import replace

    from catfree.adapters.datasets._detection_files import (
        holds_boxes,
        read_camera_boxes,
        read_missing_pictures,
    )

    try:
        boxes = read_camera_boxes(paths, camera_names, frame_rate=frame_rate)
    except CatFreeError as error:
        footage = [one for path in paths for one in _footage_in(path)]
        if not footage or any(map(holds_boxes, paths)):
            raise
        raise type(error)(
            f"{error} Videos and image folders are for catfree run and catfree calibrate, one per "
            f"camera: {shortened(' '.join(map(str, footage)))}."
        ) from error
    if silent is not None:
        boxes = replace(boxes, silent=read_missing_pictures(silent, boxes.camera_names))
    if image_size is None:
        return boxes
    if boxes.image_size is not None and (boxes.image_size != image_size).any():
        raise InvalidInputError(
            "The boxes state images of another size than --image-size. Leave out --image-size."
        )
    return replace(boxes, image_size=np.tile(image_size, (len(boxes.camera_names), 1)))


def _like_boxes(path: Path) -> str:
    """Say by which file endings a path looks like boxes, without reading it."""
    if path.is_dir():
        return f"{path} holds files that end like boxes"
    return f"{path} ends like a file of boxes ({path.suffix})"


def are_boxes(paths: tuple[Path, ...]) -> bool:
    """Return whether these are files of boxes rather than videos.

    Raises:
        InvalidInputError: if only some are boxes.
    """
    from catfree.adapters.datasets._detection_files import holds_boxes

    kinds = [os.path.exists(path) and holds_boxes(path) for path in paths]
    if any(kinds) and not all(kinds):
        raise InvalidInputError(
            f"{_like_boxes(paths[kinds.index(True)])}, but {paths[kinds.index(False)]} does not. "
            "Name either videos or files of boxes."
        )
    return any(kinds)


def joined_recording(path: Path) -> Any:
    """Open the folder of a joined recording; return None for other folders, such as a run's."""
    from catfree._run.sharded._receipt import MANIFEST
    from catfree._run.sharded._stored_tracks import open_tracks

    return open_tracks(path) if (path / MANIFEST).is_file() else None
