"""Where the ground lies on Earth: longitude and latitude of ground coordinates, and back."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from catfree.errors import InvalidInputError
from catfree.types._validation import (
    as_finite,
    as_float,
    as_number,
    as_positive,
    refuse,
    require_shape,
)

# The ellipsoid of WGS 84.
_EQUATOR, _FLATTENING = 6378137.0, 1 / 298.257223563
_SQUARED = _FLATTENING * (2 - _FLATTENING)  # of its first eccentricity
_FARTHEST = 50_000.0  # meters from the origin: the ground is a plane that touches the Earth there


@dataclass(frozen=True)
class GeoReference:
    """Where the ground is on Earth (WGS 84), and how it is turned and scaled.

    The ground is the plane that touches the ellipsoid at `longitude` and `latitude`.

    Attributes:
        longitude: degrees of the place at `origin`.
        latitude: degrees of the place at `origin`, at most 89 either way.
        heading: degrees from north, clockwise, of the ground's y axis; x is to the right of y.
        origin: (x, y) ground coordinates of that place.
        meters_per_unit: meters per scene unit.
    """

    longitude: float
    latitude: float
    heading: float = 0.0
    origin: tuple[float, float] = (0.0, 0.0)
    meters_per_unit: float = 1.0

    def __post_init__(self) -> None:
        """Validate.

        Raises:
            InvalidInputError: if a number is not finite, or not a place on Earth.
        """
        # Arrays and scalars of NumPy become floats, which have a hash and fit into JSON.
        for name in ("longitude", "latitude", "heading"):
            number = as_number(getattr(self, name), f"{name} of a georeference")
            object.__setattr__(self, name, number)
        origin = as_finite(self.origin, (2,), "origin of a georeference")
        object.__setattr__(self, "origin", tuple(origin.tolist()))
        unit = as_positive(self.meters_per_unit, "meters_per_unit of a georeference")
        object.__setattr__(self, "meters_per_unit", unit)
        _require_on_earth(np.array([[self.longitude, self.latitude]]))

    @classmethod
    def from_anchors(cls, xy: ArrayLike, longitude_latitude: ArrayLike) -> "GeoReference":
        """Fit rotation, scale and translation to points known both on the ground and on Earth.

        Args:
            xy: (A, 2) ground coordinates of at least two points.
            longitude_latitude: (A, 2) degrees of the same points (WGS 84).

        Raises:
            InvalidInputError: if there are fewer than two distinct points, a value is not finite or
                not a place on Earth, or points are more than 50 km apart.
        """
        points = as_finite(xy, (None, 2), "xy")
        degrees = _degrees(longitude_latitude)
        require_shape(degrees, (len(points), 2), "longitude_latitude")
        if len(points) < 2 or np.ptp(points, axis=0).max() == 0:
            raise InvalidInputError("A place on the map needs at least 2 different points.")
        center = middle_of(degrees)
        east_north = center.to_xy(degrees)
        # Least squares over complex numbers: a rotation times a scale is one factor.
        middle = points.mean(0)
        source, target = (points - middle) @ [1, 1j], (east_north - east_north.mean(0)) @ [1, 1j]
        factor = (source.conj() @ target) / (source.conj() @ source).real
        scale, turn = abs(factor), float(np.rad2deg(np.angle(factor)))
        if scale == 0:
            raise InvalidInputError("A place on the map needs at least 2 different points.")
        # The mean of the points goes to the mean of the places, not exactly the tangent point.
        shift = complex(*east_north.mean(0)) / factor
        origin = float(middle[0] - shift.real), float(middle[1] - shift.imag)
        return cls(center.longitude, center.latitude, -turn, origin, float(scale))

    @classmethod
    def of_array(cls, values: ArrayLike) -> "GeoReference":
        """Invert `to_array`.

        Raises:
            InvalidInputError: if they are not six valid numbers.
        """
        array = as_finite(values, (6,), "georeference")
        longitude, latitude, heading, x, y, unit = array.tolist()
        return cls(longitude, latitude, heading, (x, y), unit)

    def to_array(self) -> Float[np.ndarray, "6"]:
        """Return longitude, latitude, heading, x and y of the origin, and meters per unit."""
        values = self.longitude, self.latitude, self.heading, *self.origin, self.meters_per_unit
        return np.array(values, np.float64)

    def to_longitude_latitude(self, xy: ArrayLike) -> Float[np.ndarray, "m 2"]:
        """Return the (M, 2) longitude and latitude of (M, 2) ground coordinates in degrees.

        Raises:
            InvalidInputError: if a coordinate is not finite, or a point is more than 50 km away.

        Source: the ellipsoid's surface below each point of the plane, by Bowring (1985), "The
            accuracy of geodetic latitude and height equations".
        """
        points = as_finite(xy, (None, 2), "xy")
        with np.errstate(over="ignore", invalid="ignore"):  # such points are too far away
            east_north = self.meters_per_unit * (points - self.origin) @ self._turn.T
        near = (np.abs(east_north) <= _FARTHEST).all(axis=1)
        fault = (
            f", more than {_FARTHEST / 1000:g} km from the place of the georeference. Check its "
            "meters_per_unit and origin."
        )
        refuse(~near, points, "xy", fault)
        base, axes = _tangent_plane(self.longitude, self.latitude)
        x, y, z = (base + east_north @ axes[:2]).T
        p, polar = np.hypot(x, y), _EQUATOR * (1 - _FLATTENING)
        angle = np.arctan2(_EQUATOR * z, polar * p)
        second = _SQUARED / (1 - _SQUARED) * polar
        latitude = np.arctan2(
            z + second * np.sin(angle) ** 3, p - _SQUARED * _EQUATOR * np.cos(angle) ** 3
        )
        return np.rad2deg(np.stack([np.arctan2(y, x), latitude], -1))

    def to_xy(self, longitude_latitude: ArrayLike) -> Float[np.ndarray, "m 2"]:
        """Return the (M, 2) ground coordinates of (M, 2) longitudes and latitudes in degrees.

        Raises:
            InvalidInputError: if a place is not on Earth or is more than 50 km away.
        """
        degrees = _degrees(longitude_latitude)
        base, (east, north, up) = _tangent_plane(self.longitude, self.latitude)
        offset = _on_ellipsoid(degrees) - base
        # Project along the vertical of each place, as the inverse does.
        vertical = _up(degrees)
        offset -= vertical * ((offset @ up) / (vertical @ up))[:, None]
        east_north = np.stack([offset @ east, offset @ north], -1)
        if np.abs(east_north).max(initial=0.0) > _FARTHEST:
            raise InvalidInputError(
                f"A place is {np.abs(east_north).max() / 1000:.0f} km from the others; check that "
                "longitude comes first."
            )
        return east_north @ self._turn / self.meters_per_unit + np.array(self.origin)

    def residual(self, xy: ArrayLike, longitude_latitude: ArrayLike) -> Float[np.ndarray, " a"]:
        """Return the (A,) distances in meters between ground points and their places on Earth.

        Args:
            xy: (A, 2) ground coordinates.
            longitude_latitude: (A, 2) degrees of the same points.

        Raises:
            InvalidInputError: if the numbers of points differ, or as `to_xy`.
        """
        points, places = np.asarray(as_float(xy, "xy"), np.float64), self.to_xy(longitude_latitude)
        require_shape(points, places.shape, "xy")
        return self.meters_per_unit * np.linalg.norm(places - points, axis=-1)

    @property
    def _turn(self) -> Float[np.ndarray, "2 2"]:
        """Rotation from ground coordinates to east and north."""
        s, c = np.sin(np.deg2rad(self.heading)), np.cos(np.deg2rad(self.heading))
        return np.array([[c, s], [-s, c]])


def middle_of(degrees: Float[np.ndarray, "n 2"]) -> GeoReference:
    """Make a reference whose origin is the middle of some places and whose y axis points north."""
    longitude, latitude = degrees.mean(0).tolist()
    if np.ptp(degrees[:, 0]) > 180:  # the places straddle longitude 180
        longitude = (float((degrees[:, 0] % 360).mean()) + 180) % 360 - 180
    return GeoReference(longitude, latitude)


def _degrees(longitude_latitude: ArrayLike) -> Float[np.ndarray, "n 2"]:
    degrees = as_finite(longitude_latitude, (None, 2), "longitude_latitude")
    _require_on_earth(degrees)
    return degrees


def _require_on_earth(degrees: Float[np.ndarray, "n 2"]) -> None:
    if (np.abs(degrees) > [180, 89]).any():
        raise InvalidInputError(
            "longitude_latitude must be degrees: longitude from -180 to 180, latitude from -89 "
            "to 89. Are they in the other order?"
        )


def _up(degrees: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Outward normals of the ellipsoid in Earth-centered, Earth-fixed axes."""
    longitude, latitude = np.deg2rad(degrees).T
    level = np.cos(latitude)
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)], -1)


def _on_ellipsoid(degrees: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Earth-centered, Earth-fixed coordinates of places on the ellipsoid in meters."""
    up = _up(degrees)
    radius = _EQUATOR / np.sqrt(1 - _SQUARED * up[:, 2:] ** 2)
    return radius * up * np.array([1, 1, 1 - _SQUARED])


def _tangent_plane(
    longitude: float, latitude: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """A place on the ellipsoid, and its unit vectors east, north and up, one per row."""
    degrees = np.array([[longitude, latitude]])
    up, turn = _up(degrees)[0], np.deg2rad(longitude)
    east = np.array([-np.sin(turn), np.cos(turn), 0.0])
    return _on_ellipsoid(degrees)[0], np.stack([east, np.cross(up, east), up])
