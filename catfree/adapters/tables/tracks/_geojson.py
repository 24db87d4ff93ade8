"""Tracks on the map of the world: GeoJSON, by points whose longitude and latitude are known."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from catfree.adapters.files._documents import StrPath, write_text_atomically
from catfree.adapters.tables.tracks._tracked_rows import tracked
from catfree.errors import InvalidInputError
from catfree.types import Tracks
from catfree.types._validation import as_float, require_finite, require_shape

# The ellipsoid of WGS 84.
_EQUATOR, _FLATTENING = 6378137.0, 1 / 298.257223563
_FARTHEST = 50_000.0  # meters from the middle of the anchors: the map is flat


@dataclass(frozen=True, eq=False)
class GeoReference:
    """Where the ground is on Earth, and how it is turned and scaled.

    Attributes:
        longitude: degrees of the middle of the anchors.
        latitude: degrees of the middle of the anchors.
        origin: (2,) ground coordinates of the same place.
        turn: (2, 2) matrix from ground coordinates to meters east and north; a rotation times the
            meters per scene unit.
        residual: (A,) meters between each anchor and where it should be.
    """

    longitude: float
    latitude: float
    origin: Float[np.ndarray, "2"]
    turn: Float[np.ndarray, "2 2"]
    residual: Float[np.ndarray, " a"]

    @classmethod
    def from_anchors(cls, xy: ArrayLike, longitude_latitude: ArrayLike) -> "GeoReference":
        """Fit rotation, scale and translation to points that are known on both sides.

        Args:
            xy: (A, 2) ground coordinates of at least two points.
            longitude_latitude: (A, 2) degrees of the same points (WGS 84).

        Raises:
            InvalidInputError: if there are fewer than two different points, a value is not finite
                or no place on Earth, or the points are farther than 50 km apart.
        """
        points = np.asarray(as_float(xy), np.float64)
        degrees = np.asarray(as_float(longitude_latitude), np.float64)
        require_shape(points, (None, 2), "xy")
        require_shape(degrees, (len(points), 2), "longitude_latitude")
        require_finite(points, "xy")
        require_finite(degrees, "longitude_latitude")
        if (np.abs(degrees) > [180, 89]).any():
            raise InvalidInputError(
                "longitude_latitude must be degrees: longitude from -180 to 180, latitude from -89 "
                "to 89. Are they in the other order?"
            )
        if len(points) < 2 or np.ptp(points, axis=0).max() == 0:
            raise InvalidInputError("A place on the map needs at least 2 different points.")
        middle = degrees.mean(0)
        east_north = (degrees - middle) * _meters_per_degree(middle[1])
        if np.abs(east_north).max() > _FARTHEST:
            raise InvalidInputError(
                f"The points are {np.abs(east_north).max() / 1000:.0f} km from their middle; check "
                "that longitude comes first."
            )
        origin = points.mean(0)
        # Least squares over complex numbers: a rotation times a scale is one factor.
        near = (points - origin) @ [1, 1j]
        factor = (near.conj() @ (east_north @ [1, 1j])) / (near.conj() @ near).real
        turn = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]])
        off = (points - origin) @ turn.T - east_north
        residual = np.linalg.norm(off, axis=-1)
        return cls(float(middle[0]), float(middle[1]), origin, turn, residual)

    @property
    def meters_per_unit(self) -> float:
        """Meters per scene unit: 1 if the scene is metric, and anchors and scene agree."""
        return float(np.sqrt(np.linalg.det(self.turn)))

    def to_longitude_latitude(self, xy: ArrayLike) -> Float[np.ndarray, "m 2"]:
        """Return the (M, 2) longitude and latitude of (M, 2) ground coordinates in degrees."""
        points = np.asarray(as_float(xy), np.float64)
        require_shape(points, (None, 2), "xy")
        east_north = (points - self.origin) @ self.turn.T
        scale = _meters_per_degree(self.latitude)
        return east_north / scale + [self.longitude, self.latitude]

    def to_xy(self, longitude_latitude: ArrayLike) -> Float[np.ndarray, "m 2"]:
        """Return the (M, 2) ground coordinates of (M, 2) longitudes and latitudes in degrees."""
        degrees = np.asarray(as_float(longitude_latitude), np.float64)
        require_shape(degrees, (None, 2), "longitude_latitude")
        scale = _meters_per_degree(self.latitude)
        east_north = (degrees - [self.longitude, self.latitude]) * scale
        return np.linalg.solve(self.turn, east_north.T).T + self.origin


def write_geojson(path: StrPath, tracks: Tracks, reference: GeoReference) -> Path:
    """Write one line per track, or a point if it has one position, as GeoJSON (RFC 7946).

    Each feature has `track_id`, `frame` (a list, one number per point), `sigma` in meters and,
    with a clock, `time_s`.

    Args:
        path: the file.
        tracks: what to write; positions without a track are left out.
        reference: where the ground is.

    Returns:
        The path.

    Raises:
        InvalidInputError: if a position is not finite, or the folder does not exist.
        WriteError: if the disk is full or not writable.
    """
    kept = tracked(tracks, path)
    place = reference.to_longitude_latitude(kept.ground_xy)
    time, scale = kept.time, reference.meters_per_unit
    features = []
    for person in np.unique(kept.track_id).tolist():
        rows = np.flatnonzero(kept.track_id == person)
        rows = rows[np.argsort(kept.frame[rows], kind="stable")]
        points = place[rows].tolist()
        sigma = np.asarray(kept.sigma, np.float64)[rows] * scale
        properties: dict[str, Any] = {"track_id": person, "frame": kept.frame[rows].tolist()}
        properties["sigma"] = [value if np.isfinite(value) else None for value in sigma.tolist()]
        if time is not None:
            properties["time_s"] = time[rows].tolist()
        line = {"type": "LineString", "coordinates": points}
        point = {"type": "Point", "coordinates": points[0]}
        features.append(
            {
                "type": "Feature",
                "id": person,
                "geometry": line if len(points) > 1 else point,
                "properties": properties,
            }
        )
    document = {"type": "FeatureCollection", "features": features}
    return write_text_atomically(path, json.dumps(document, allow_nan=False) + "\n")


def _meters_per_degree(latitude: float) -> Float[np.ndarray, "2"]:
    """(2,) meters of one degree of longitude and of latitude, on the ellipsoid at a latitude."""
    squared = _FLATTENING * (2 - _FLATTENING)
    angle = np.deg2rad(latitude)
    bulge = 1 - squared * np.sin(angle) ** 2
    east = _EQUATOR / np.sqrt(bulge) * np.cos(angle)
    north = _EQUATOR * (1 - squared) / bulge**1.5
    return np.deg2rad(np.array([east, north]))
