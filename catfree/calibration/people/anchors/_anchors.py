"""Anchors: independent measurements of a site, each with its standard deviation."""

import os
from collections.abc import Collection, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from catfree.adapters.files._documents import entry, list_of, read_json
from catfree.errors import FileFormatError, InvalidInputError, quoted, shortened
from catfree.types import GeoReference
from catfree.types._georeference import middle_of
from catfree.types._validation import as_positive

Pixel = tuple[float, float]
LARGEST_COORDINATE = 1e5  # meters; float32 results resolve a centimeter up to there


@dataclass(frozen=True)
class KnownDistance:
    """A length on the ground between two pixels of one camera.

    Attributes:
        camera: index or name of the camera.
        pixels: two points of the ground in the camera's image.
        meters: the distance between them.
        sd: its standard deviation in meters.
        pixel_sd: standard deviation of each pixel coordinate.
    """

    camera: int | str
    pixels: tuple[Pixel, Pixel]
    meters: float
    sd: float = 0.02
    pixel_sd: float = 2.0

    def __post_init__(self) -> None:
        """Validate.

        Raises:
            InvalidInputError: if a value is missing, not finite or not positive.
        """
        _require_camera(self)
        pixels = _numbers(self.pixels, "pixels of a KnownDistance", (2, 2))
        if (pixels[0] == pixels[1]).all():
            raise InvalidInputError("The two pixels of a KnownDistance are the same point.")
        _store_array(self, "pixels", pixels)
        _store_positive(self, "meters", "sd", "pixel_sd")


@dataclass(frozen=True)
class KnownCamera:
    """Known quantities of a camera; unknown ones stay None.

    Attributes:
        camera: index or name of the camera.
        height: meters above the ground.
        height_sd: its standard deviation in meters.
        focal: focal length in pixels.
        focal_sd: its standard deviation in pixels.
        position: (x, y) or (x, y, z) of the center in meters of the map frame, z above the ground.
        longitude: degrees (WGS 84) of the center, with `latitude` instead of `position`.
        latitude: degrees.
        position_sd: standard deviation of each coordinate in meters.
        rotation: 3 rows, from the map frame (z up) to camera axes (x right, y down, z forward).
        rotation_sd: its standard deviation in degrees about each axis.
    """

    camera: int | str
    height: float | None = None
    height_sd: float = 0.05
    focal: float | None = None
    focal_sd: float = 10.0
    position: tuple[float, ...] | None = None
    longitude: float | None = None
    latitude: float | None = None
    position_sd: float = 0.05
    rotation: tuple[tuple[float, float, float], ...] | None = None
    rotation_sd: float = 0.5

    def __post_init__(self) -> None:
        """Validate.

        Raises:
            InvalidInputError: if nothing is known, or a value is invalid.
        """
        _require_camera(self)
        known = (self.height, self.focal, self.position, self.longitude, self.rotation)
        if all(value is None for value in known):
            raise InvalidInputError(
                f"KnownCamera({quoted(self.camera)}) states nothing; give its height, focal, "
                "position, longitude and latitude, or rotation."
            )
        stated = (name for name in ("height", "focal") if getattr(self, name) is not None)
        _store_positive(self, *stated, "height_sd", "focal_sd", "position_sd", "rotation_sd")
        if self.position is not None:
            position = _numbers(self.position, "position of a KnownCamera", (2,), (3,))
            _store_array(self, "position", position)
        _require_place(self)
        if self.rotation is not None:
            R = _numbers(self.rotation, "rotation of a KnownCamera", (3, 3))
            large = np.abs(R).max() > 2  # products may overflow
            if large or np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
                raise InvalidInputError("rotation of a KnownCamera must be a rotation matrix.")
            _store_array(self, "rotation", R)


@dataclass(frozen=True)
class SurveyedPoint:
    """A point of the ground that is visible in a camera and known on a map.

    Attributes:
        camera: index or name of the camera.
        pixel: the point in its image.
        position: (x, y) in meters of the map frame; x, y and up are right-handed.
        longitude: degrees (WGS 84), with `latitude` instead of `position`.
        latitude: degrees.
        sd: standard deviation of each coordinate on the map in meters.
        pixel_sd: standard deviation of each pixel coordinate.
    """

    camera: int | str
    pixel: Pixel
    position: tuple[float, float] | None = None
    longitude: float | None = None
    latitude: float | None = None
    sd: float = 0.05
    pixel_sd: float = 2.0

    def __post_init__(self) -> None:
        """Validate.

        Raises:
            InvalidInputError: if a value is missing or invalid.
        """
        _require_camera(self)
        _store_array(self, "pixel", _numbers(self.pixel, "pixel of a SurveyedPoint", (2,)))
        if self.position is not None:
            position = _numbers(self.position, "position of a SurveyedPoint", (2,))
            _store_array(self, "position", position)
        _require_place(self)
        if self.position is None and self.longitude is None:
            raise InvalidInputError(
                "A SurveyedPoint needs a position, or a longitude and latitude."
            )
        _store_positive(self, "sd", "pixel_sd")


Anchor = KnownDistance | KnownCamera | SurveyedPoint


@dataclass(frozen=True)
class AnchorCheck:
    """One stated quantity, compared with the people and all other anchors.

    Attributes:
        anchor: the anchor that states it; None for the mean height of the people.
        quantity: "distance", "height", "focal length", "position", "rotation", "point" or "people".
        difference: stated minus expected, per coordinate: meters, pixels for focal lengths, degrees
            for rotations; NaN if nothing else determines it.
        sd: standard deviation of this difference, per coordinate.
        p_value: probability of a larger difference by chance (chi-square).
        used: whether it enters the rig; if not, the height of the people still is a weak prior.
        sentence: the comparison in words.
    """

    anchor: Anchor | None
    quantity: str
    difference: tuple[float, ...]
    sd: tuple[float, ...]
    p_value: float
    used: bool
    sentence: str


_LISTS = {"distances": KnownDistance, "cameras": KnownCamera, "points": SurveyedPoint}


def read_anchors(path: str | os.PathLike[str]) -> tuple[Anchor, ...]:
    """Read anchors from a JSON file: lists named `distances`, `cameras` and `points`.

        {"distances": [{"camera": "north", "pixels": [[640, 500], [810, 505]], "meters": 5.0}],
         "cameras": [{"camera": "east", "height": 4.1}],
         "points": [{"camera": 0, "pixel": [512, 700], "longitude": 8.547, "latitude": 47.376}]}

    Args:
        path: the file. Its entries have the attributes of `KnownDistance`, `KnownCamera` and
            `SurveyedPoint`; those with defaults are optional.

    Returns:
        The anchors.

    Raises:
        InvalidInputError: if there is no such file, or a value is invalid.
        FileFormatError: if the file is not JSON of this form.
    """
    document = read_json(path, "anchors")
    if not isinstance(document, dict):
        raise FileFormatError(
            f"{path}: anchors are an object with the lists distances, cameras and points."
        )
    _require_known(document, _LISTS, str(path))
    anchors: list[Anchor] = []
    for name, kind in _LISTS.items():
        for at, values in enumerate(list_of(document.get(name, []), f"{path}: {name}")):
            where = f"{path}: entry {at} of {name}"
            camera = entry(values, "camera", where)
            _require_known(values, sorted(field.name for field in fields(kind)), where)
            for field in fields(kind):
                if field.default is MISSING:
                    entry(values, field.name, where)
            if type(camera) not in (int, str):
                raise InvalidInputError(
                    f"{where}: camera is {quoted(camera)}; it must be the index or the name of one."
                )
            try:
                stated = {
                    key: value if key == "camera" else _floats(value)
                    for key, value in values.items()
                }
                anchors.append(kind(**stated))
            except (TypeError, ValueError, OverflowError, InvalidInputError) as error:
                raise InvalidInputError(f"{where}: {error}") from error
    return tuple(anchors)


def _require_known(mapping: dict[str, Any], names: Collection[str], where: str) -> None:
    """Raise if an object has other entries than these."""
    if unknown := mapping.keys() - set(names):
        raise FileFormatError(
            f"{where} has {quoted(min(unknown))}; it may have {', '.join(names)}."
        )


def _floats(value: Any) -> Any:
    """Convert lists to tuples, and whole numbers to floats."""
    if isinstance(value, list):
        return tuple(map(_floats, value))
    return float(value) if type(value) is int else value


def resolve_anchors(
    anchors: Sequence[Anchor],
    image_size: Int[np.ndarray, "cam 2"],
    names: Sequence[str] | None = None,
) -> tuple[tuple[int, ...], GeoReference | None]:
    """Find the camera of each anchor, and check that a map frame is determined.

    Args:
        anchors: the anchors.
        image_size: (C, 2) width and height of the cameras' images in pixels.
        names: (C,) names of the cameras.

    Returns:
        The camera index of each anchor and, if anchors are on Earth, the reference of a frame with
        x east and y north whose origin is their middle.

    Raises:
        InvalidInputError: if a camera does not exist, a pixel is outside its image, or positions on
            the map are too few, mixed with longitudes and latitudes, or too far away.
    """
    cameras = len(image_size)
    if not isinstance(anchors, Sequence):
        raise InvalidInputError(
            f"anchors must be a list, got {type(anchors).__name__}. Put even a single one in "
            "brackets."
        )
    index = []
    for anchor in anchors:
        if not isinstance(anchor, Anchor):
            raise InvalidInputError(
                "anchors must hold KnownDistance, KnownCamera or SurveyedPoint, got "
                f"{type(anchor).__name__}."
            )
        camera = anchor.camera
        if isinstance(camera, str) and names is not None and camera in names:
            camera = list(names).index(camera)
        if not isinstance(camera, int | np.integer) or not 0 <= camera < cameras:
            raise InvalidInputError(
                f"An anchor refers to camera {quoted(camera)}, but the cameras are "
                f"{shortened(', '.join(names)) if names else f'0 to {cameras - 1}'}."
            )
        index.append(int(camera))
        size = image_size[index[-1]]
        for pixel in _pixels(anchor):
            # Some programs count pixels from the corner of the image, not from the center of a
            # pixel.
            if not (-1 <= pixel[0] <= size[0] and -1 <= pixel[1] <= size[1]):
                raise InvalidInputError(
                    f"An anchor has the pixel {quoted(pixel)}, outside the image of camera "
                    f"{quoted(anchor.camera)}, which has {size[0]} x {size[1]} px. Give pixels of "
                    "pictures of this size."
                )
    placed = [anchor for anchor in anchors if not isinstance(anchor, KnownDistance)]
    degrees = np.array([(a.longitude, a.latitude) for a in placed if a.longitude is not None])
    places = np.array([a.position[:2] for a in placed if a.position is not None])
    if len(degrees) and len(places):
        raise InvalidInputError(
            "Some anchors have positions in meters, others longitudes; use one form for all."
        )
    if np.abs(places).max(initial=0.0) > LARGEST_COORDINATE:
        raise InvalidInputError(
            f"An anchor is {np.abs(places).max() / 1000:.0f} km from the origin of the map. "
            "Subtract the same round numbers from all positions, so that results are precise."
        )
    has_rotation = any(isinstance(a, KnownCamera) and a.rotation is not None for a in placed)
    different = len(np.unique((degrees if len(degrees) else places).reshape(-1, 2), axis=0))
    if different + has_rotation == 1:
        raise InvalidInputError(
            "Anchors on a map must determine where it lies: give two different points or camera "
            "positions, or the position and rotation of a camera."
        )
    earth = middle_of(degrees) if len(degrees) else None
    return tuple(index), earth


def _pixels(anchor: Anchor) -> tuple[Pixel, ...]:
    """Return the points in a camera's image that an anchor states."""
    if isinstance(anchor, KnownDistance):
        return anchor.pixels
    return (anchor.pixel,) if isinstance(anchor, SurveyedPoint) else ()


def _require_place(anchor: KnownCamera | SurveyedPoint) -> None:
    """Raise if a place on the map is incomplete or stated twice."""
    position, longitude, latitude = anchor.position, anchor.longitude, anchor.latitude
    kind = type(anchor).__name__
    if (longitude is None) != (latitude is None):
        raise InvalidInputError(f"A {kind} needs both longitude and latitude, or neither.")
    if longitude is not None and latitude is not None:
        degrees = _numbers((longitude, latitude), f"longitude and latitude of a {kind}", (2,))
        place = GeoReference(*degrees.tolist())
        object.__setattr__(anchor, "longitude", place.longitude)
        object.__setattr__(anchor, "latitude", place.latitude)
        if position is not None:
            raise InvalidInputError(
                f"A {kind} has a position or a longitude and latitude, not both."
            )


def _require_camera(anchor: Anchor) -> None:
    is_index = isinstance(anchor.camera, int | np.integer) and not isinstance(anchor.camera, bool)
    if not is_index and not isinstance(anchor.camera, str):
        raise InvalidInputError(
            f"camera of a {type(anchor).__name__} is {quoted(anchor.camera)}; it must be the index "
            "or the name of one."
        )


def _store_positive(anchor: Anchor, *names: str) -> None:
    """Store attributes of an anchor as floats, which must be positive."""
    for name in names:
        number = as_positive(getattr(anchor, name), f"{name} of a {type(anchor).__name__}")
        object.__setattr__(anchor, name, number)


def _store_array(anchor: Anchor, name: str, values: Float[np.ndarray, "..."]) -> None:
    """Store an attribute of an anchor as a tuple, or tuple of tuples, which has a hash."""
    rows = values.tolist()
    object.__setattr__(anchor, name, tuple(map(tuple, rows)) if values.ndim == 2 else tuple(rows))


def _numbers(values: object, name: str, *shapes: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    try:
        array = np.asarray(values)
    except ValueError:  # lists of different lengths
        array = np.array(None)
    if array.dtype.kind not in "fiu" or array.shape not in shapes or not np.isfinite(array).all():
        expected = " or ".join(map(str, shapes))
        raise InvalidInputError(
            f"{name} must be finite numbers of shape {expected}, got {quoted(values)}."
        )
    return array.astype(np.float64)
