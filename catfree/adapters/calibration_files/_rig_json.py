"""Rigs and scenes as plain JSON that states its own conventions."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from catfree.adapters.calibration_files._named_rig import (
    FileCamera,
    NamedRig,
    default_names,
    lens_coefficients,
    rig_of,
)
from catfree.adapters.files._documents import (
    StrPath,
    entry,
    list_of,
    naming_file,
    numbers,
    numbers_of,
    read_json,
    text_of,
    write_text_atomically,
)
from catfree.errors import FileFormatError, quoted, shortened
from catfree.types import GeoReference, Lens, Plane, Rig, Scene
from catfree.types._scene import require_plausible_heights, require_scene
from catfree.types._validation import as_flag

_CONVENTIONS = {
    "camera": "x_camera = R x_world + t; x right, y down, z forward",
    "pixel": "the center of the top-left pixel is (0, 0)",
    "distortion": "OpenCV k1, k2, p1, p2, k3 and optionally k4, k5, k6; of a fisheye k1 to k4",
    "lens": "pinhole if not stated, fisheye (cv2.fisheye), or rays: rows of unit vectors in camera "
    "axes, evenly spaced from the outer edge of the first pixel to that of the last one",
    "ground": "normal . x + offset = 0, cameras on the positive side",
    "unregistered camera": "registered is false and its numbers are null",
}
_UNITS = {True: "m", False: "arbitrary"}


def write_rig_json(
    path: StrPath, rig: Rig, names: Sequence[str] | None = None, *, metric: bool = False
) -> Path:
    """Write a rig.

    Args:
        path: the file.
        rig: the cameras; unregistered ones are kept and marked.
        names: (C,) names; C1, C2, ... if None.
        metric: whether the rig's units are meters; stated in the file.

    Returns:
        The path.

    Raises:
        InvalidInputError: if the folder does not exist, the names do not match the cameras, or
            metric is neither true nor false.
    """
    document = _rig_document(rig, names, as_flag(metric, "metric"))
    return write_text_atomically(path, _text(document))


def write_scene_json(path: StrPath, scene: Scene, names: Sequence[str] | None = None) -> Path:
    """Write a scene: rig, ground plane and extent.

    Args:
        path: the file.
        scene: the scene; unregistered cameras are kept and marked.
        names: (C,) names; C1, C2, ... if None.

    Returns:
        The path.

    Raises:
        InvalidInputError: if the folder does not exist or the names do not match the cameras.
    """
    return write_text_atomically(path, scene_text(scene, names))


def scene_text(scene: Scene, names: Sequence[str] | None = None) -> str:
    """Return the text that `write_scene_json` writes.

    Raises:
        InvalidInputError: if the names do not match the cameras.
    """
    require_scene(scene)
    ground = {"normal": _list(scene.ground.normal), "offset": float(scene.ground.offset)}
    document = _rig_document(scene.rig, names, scene.metric)
    document |= {"ground": ground, "extent": float(scene.extent)}
    if scene.rig_sd is not None:
        document["rig_sd"] = float(scene.rig_sd)
    if scene.georeference is not None:
        document["georeference"] = dataclasses.asdict(scene.georeference)
    return _text(document)


def read_rig_json(path: StrPath) -> NamedRig:
    """Read a rig from a file that `write_rig_json` or `write_scene_json` wrote.

    Args:
        path: the file.

    Returns:
        The rig with the names of its cameras.

    Raises:
        InvalidInputError: if there is no such file or a camera is invalid.
        FileFormatError: if the file is not JSON of this form.
    """
    document = read_json(path, "rig")
    with naming_file(path):
        return _read_rig(document)


def read_scene_json(path: StrPath) -> tuple[Scene, tuple[str, ...]]:
    """Read scene and camera names from a file that `write_scene_json` wrote.

    Args:
        path: the file.

    Returns:
        The scene, and the (C,) names of its cameras.

    Raises:
        InvalidInputError: if there is no such file or a value is invalid.
        FileFormatError: if the file is not JSON of this form.
    """
    document = read_json(path, "scene")
    with naming_file(path):
        named = _read_rig(document)
        ground = entry(document, "ground")
        plane = Plane(
            numbers_of(ground, "normal", (3,), "ground"), numbers_of(ground, "offset", (), "ground")
        )
        extent = numbers_of(document, "extent", ())
        metric = document["units"] == _UNITS[True]
        earth = document.get("georeference")
        if earth is not None:
            names = [field.name for field in dataclasses.fields(GeoReference)]
            values = [numbers_of(earth, name, None, "georeference") for name in names]
            earth = GeoReference.of_array(np.concatenate(values))
        scene = Scene(named.rig, plane, extent, metric, earth, document.get("rig_sd"))
        return require_plausible_heights(scene), named.names


def _rig_document(rig: Rig, names: Sequence[str] | None, metric: bool) -> dict[str, Any]:
    cameras = []
    for at, name in enumerate(default_names(rig, names)):
        width, height = rig.image_size[at].tolist()
        camera = {"name": name, "width": width, "height": height}
        camera |= {key: _list(getattr(rig, key)[at]) for key in ("K", "R", "t")}
        camera["distortion"] = None if rig.distortion is None else _list(rig.distortion[at])
        if rig.lens is not None:
            camera["lens"] = Lens(rig.lens[at]).name.lower()
            if rig.lens[at] == Lens.RAYS:
                assert rig.rays is not None
                camera["rays"] = _list(rig.rays[at])
        camera["registered"] = bool(rig.registered[at])
        cameras.append(camera)
    return {"units": _UNITS[metric], "conventions": _CONVENTIONS, "cameras": cameras}


def _list(values: Any) -> Any:
    """Convert to nested lists of floats, None for numbers that are not finite (JSON has no NaN)."""
    array = np.asarray(values, np.float64)
    entries = array.astype(object)
    entries[~np.isfinite(array)] = None
    return entries.tolist()


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _read_rig(document: Any) -> NamedRig:
    units = entry(document, "units")
    if units not in _UNITS.values():
        raise FileFormatError(
            f"the file has units {quoted(units)}; they must be 'm' or 'arbitrary'."
        )
    listed = list_of(entry(document, "cameras"), "cameras")
    if not listed:
        raise FileFormatError("the file holds no camera.")
    names, cameras = [], []
    for at, camera in enumerate(listed):
        where = f"camera {at}"
        names.append(text_of(entry(camera, "name", where), f"the name of {where}"))
        registered = camera.get("registered", True)
        if not isinstance(registered, bool):
            raise FileFormatError(
                f"registered of {where} ({shortened(names[-1])}) is {quoted(registered)}; it must "
                "be true or false."
            )
        K, R, t = (
            numbers_of(camera, key, shape, where, finite=registered)
            for key, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,)))
        )
        pair = [entry(camera, key, where) for key in ("width", "height")]
        size = numbers(pair, (2,), f"the image size of {where}")
        lens = _lens(camera.get("lens", "pinhole"), where)
        values = camera.get("distortion") if registered else None
        coefficients = lens_coefficients([] if values is None else values, where, lens)
        rays = _grid(camera, registered, where) if lens == Lens.RAYS else None
        cameras.append(FileCamera(K, R, t, size, coefficients, lens, registered, rays))
    return NamedRig(rig_of(cameras), tuple(names))


def _lens(name: Any, where: str) -> Lens:
    """Lens model that a file names.

    Raises:
        FileFormatError: if it is not one of `Lens`.
    """
    known = {lens.name.lower(): lens for lens in Lens}
    if not isinstance(name, str) or name not in known:
        raise FileFormatError(
            f"the lens of {where} is {quoted(name)}; it must be one of {', '.join(known)}."
        )
    return known[name]


def _grid(camera: Any, registered: bool, where: str) -> np.ndarray:
    """Rays (rows, columns, 3) of a camera."""
    nested = entry(camera, "rays", where)
    rows = len(nested) if isinstance(nested, list) else 0
    values = numbers(nested, None, f"rays of {where}", finite=registered)
    if not values.size or values.size % (3 * rows):
        raise FileFormatError(f"rays of {where} must hold rows of vectors x, y, z.")
    return values.reshape(rows, -1, 3)
