"""Tracks on the world map as GeoJSON, located by a georeference."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from catfree.adapters.files._documents import StrPath, write_text_atomically
from catfree.adapters.tables.tracks._tracked_rows import tracked
from catfree.errors import InvalidInputError
from catfree.types import GeoReference, Scene, Tracks
from catfree.types._validation import require_instance


def write_geojson(path: StrPath, tracks: Tracks, reference: GeoReference | Scene) -> Path:
    """Write one line per track, or a point if it has one position, as GeoJSON (RFC 7946).

    Each feature has `track_id`, `frame` (a list, one number per point), `sigma` in meters and,
    with a clock, `time_s`.

    Args:
        path: the file.
        tracks: the tracks to write; positions without a track are left out.
        reference: georeference of the ground, or a scene that has one.

    Returns:
        The path.

    Raises:
        InvalidInputError: if a position is not finite, the scene has no georeference, or the
            folder does not exist.
        WriteError: if the disk is full or not writable.
    """
    if isinstance(reference, Scene):
        if reference.georeference is None:
            raise InvalidInputError(
                "The scene has no georeference. Calibrate with anchors that have longitude and "
                "latitude, or pass a GeoReference."
            )
        reference = reference.georeference
    require_instance(reference, GeoReference, "reference")
    kept = tracked(tracks, path)
    longitude_latitude = reference.to_longitude_latitude(kept.ground_xy)
    time, scale = kept.time, reference.meters_per_unit
    features = []
    for person in np.unique(kept.track_id).tolist():
        rows = np.flatnonzero(kept.track_id == person)
        rows = rows[np.argsort(kept.frame[rows], kind="stable")]
        points = longitude_latitude[rows].tolist()
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
