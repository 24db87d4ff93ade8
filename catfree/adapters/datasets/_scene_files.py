"""`read_scene`: cameras and ground from a calibration in any format that the library reads."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from catfree.adapters.calibration_files._ai_city import read_ai_city
from catfree.adapters.calibration_files._anipose_toml import read_anipose_toml
from catfree.adapters.calibration_files._named_rig import (
    NamedRig,
    ground_at_zero,
    require_stated_sizes,
)
from catfree.adapters.calibration_files._opencv_yaml import read_opencv_yaml
from catfree.adapters.calibration_files._projection_matrices import PROJECTION, read_mv3dt
from catfree.adapters.calibration_files._rig_json import read_rig_json, read_scene_json
from catfree.adapters.calibration_files.colmap._colmap import read_colmap
from catfree.adapters.datasets._multiviewx import read_multiviewx
from catfree.adapters.datasets._uniform_json import read_uniform_json
from catfree.adapters.datasets._wildtrack import read_wildtrack
from catfree.adapters.files._camera_names import files_ending
from catfree.adapters.files._documents import StrPath, naming_file, read_json, read_text
from catfree.errors import FileFormatError, InvalidInputError, quoted
from catfree.types import Plane, Scene
from catfree.types._validation import as_path, as_paths, require_instance

Unit = Literal["m", "cm", "mm", "ft", "arbitrary"]
NamedScene = tuple[Scene, tuple[str, ...] | None]
METERS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "arbitrary": 1.0}
PER_CAMERA = (".yml", ".yaml", ".xml", ".json")
FORMATS = (
    "scene.json or .npz, rig.json, a COLMAP model, anipose calibration.toml, OpenCV YAML, XML or "
    "JSON, MV3DT camInfo, AI City calibration.json, uniform JSON, WildTrack, or MultiviewX"
)


def read_scene(
    path: StrPath | Sequence[StrPath],
    ground: Plane | None = None,
    unit: Unit = "m",
    *,
    image_size: tuple[int, int] | None = None,
) -> tuple[Scene, tuple[str, ...] | None]:
    """Read cameras and ground from a calibration in any format that the library reads.

    Formats: catfree's `scene.json` and `.npz`, `rig.json`, COLMAP models (the folder or one of
    its files), `calibration.toml` of anipose (Pose2Sim, caliscope, FreeMoCap), OpenCV's YAML, XML
    or JSON files and MV3DT's `camInfo` files (one per camera: their folder or a list),
    `calibration.json` of AI City, uniform JSON, and the folders of WildTrack and MultiviewX.

    Args:
        path: a file or folder, or the cameras' files in their order.
        ground: the plane that people stand on, in the file's frame and unit; giving one drops the
            file's georeference. None takes the plane that the file states, or else z = 0.
        unit: unit of length, if the file does not state it; "arbitrary" if unknown, as in a COLMAP
            model that was not scaled.
        image_size: width and height in pixels where the files do not state them.

    Returns:
        The scene, in meters unless the unit is arbitrary, and the (C,) names of its cameras, or
        None if the file has none.

    Raises:
        InvalidInputError: if there is no such file, a value or the ground is invalid, the file
            states another unit or image size, or no ground is stated and z = 0 cannot be it.
        FileFormatError: if the file has another format.
    """
    if not isinstance(unit, str) or unit not in METERS:
        raise InvalidInputError(f"unit is {quoted(unit)}; it must be one of {', '.join(METERS)}.")
    if ground is not None:
        require_instance(ground, Plane, "ground")
    if isinstance(path, str | os.PathLike):
        source = as_path(path, "path")
        if not source.exists():
            raise InvalidInputError(f"There is no file {source} (calibration). Check the path.")
        source = _inside(source)
        found, stated = _read(source, image_size)
    else:
        source = "the calibration"
        found, stated = _per_camera(as_paths(path, "path"), image_size), None
    rig, names = (found[0].rig, found[1]) if isinstance(found, tuple) else (found.rig, found.names)
    with naming_file(source):
        require_stated_sizes(rig, names, image_size)
    if stated is not None:
        if unit != "m":
            raise InvalidInputError(
                f"{source} states its unit of length; leave out the unit {unit!r}."
            )
        unit = stated
    if isinstance(found, tuple):
        scene = found[0]
        if ground is None:
            return scene, names
        # Stating the ground does not make the cameras more certain.
        with naming_file(source):
            other = Scene.from_rig(scene.rig, ground, scene.metric)
        return replace(other, rig_sd=scene.rig_sd), names
    scale = METERS[unit]
    if ground is None:
        ground = ground_at_zero(rig, source)
    plane = Plane(np.asarray(ground.normal), np.asarray(ground.offset) * scale)
    scaled = replace(rig, t=np.asarray(rig.t) * scale) if scale != 1 else rig
    with naming_file(source):
        scene = Scene.from_rig(scaled, plane, metric=unit != "arbitrary")
    return scene, names


def _inside(source: Path) -> Path:
    """Find a folder's calibration: the folder itself, a model in it, or a run's scene."""
    if not source.is_dir():
        # One file of a model stands for the whole model.
        is_model = source.stem in ("cameras", "images", "points3D")
        is_model = is_model and source.suffix in (".bin", ".txt")
        return source.parent if is_model else source
    if _is_model(source):
        return source
    for subfolder in ("sparse/0", "sparse", "0"):
        if _is_model(source / subfolder):
            return source / subfolder
    for name in ("scene.json", "rig.json"):
        if (source / name).is_file():
            return source / name
    anipose = [path for path in files_ending(source, [".toml"]) if "calib" in path.stem.lower()]
    if len(anipose) == 1:
        return anipose[0]
    sensors = source / "calibration.json"
    if sensors.is_file() and '"sensors"' in read_text(sensors, "calibration"):
        return sensors
    return source / "camInfo" if (source / "camInfo").is_dir() else source


def _is_model(folder: Path) -> bool:
    return any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt"))


def _read(
    source: Path, image_size: tuple[int, int] | None
) -> tuple[NamedRig | NamedScene, Unit | None]:
    """Read cameras, and ground and unit if the source states them."""
    if source.is_dir():
        inner = source / "calibrations"
        if inner.is_dir():
            is_wildtrack = any(inner.glob("**/*CVLab*"))
            sequence = read_wildtrack(source) if is_wildtrack else read_multiviewx(source)
            assert sequence.scene is not None
            return (sequence.scene, sequence.camera_names), "m"
        if _is_model(source):
            return read_colmap(source), None
        files = files_ending(source, PER_CAMERA)
        if not files:
            raise InvalidInputError(f"The folder {source} holds no known calibration: {FORMATS}.")
        return _per_camera(files, image_size), None
    suffix = source.suffix.lower()
    if suffix == ".npz":
        scene = Scene.load(source)
        return (scene, None), _unit(scene.metric)
    if suffix == ".toml":
        return read_anipose_toml(source), None
    if suffix == ".json":
        document = read_json(source, "calibration")
        if not isinstance(document, dict):
            raise FileFormatError(f"{source} is not a calibration: {FORMATS}.")
        if "ground" in document and "extent" in document:
            scene, names = read_scene_json(source)
            return (scene, names), _unit(scene.metric)
        if "frames" in document:
            sequence = read_uniform_json(source)
            if sequence.scene is None:
                raise InvalidInputError(
                    f"{source} has no calibration of two cameras or more (K, R, t, width, height)."
                )
            return (sequence.scene, sequence.camera_names), "m"
        if "sensors" in document:
            return read_ai_city(source, image_size), None
        if "cameras" in document:
            return read_rig_json(source), _unit(document["units"] == "m")
    if suffix in PER_CAMERA:
        return _per_camera([source], image_size), None
    raise FileFormatError(f"{source} is not a known calibration: {FORMATS}.")


def _unit(metric: bool) -> Unit:
    return "m" if metric else "arbitrary"


def _per_camera(files: list[Path], image_size: tuple[int, int] | None) -> NamedRig:
    """Read one file per camera, of OpenCV or of MV3DT."""
    if files and PROJECTION in read_text(files[0], "calibration"):
        return read_mv3dt(files, image_size)
    return read_opencv_yaml(files, image_size=image_size)
