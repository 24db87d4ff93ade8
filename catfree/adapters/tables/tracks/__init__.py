"""Tracks in the forms of other programs: pedestrian dynamics, maps, benchmarks, behavior."""

from catfree.adapters.tables.tracks._ai_city_tracks import (
    read_ai_city_tracks as read_ai_city_tracks,
    write_ai_city_tracks as write_ai_city_tracks,
)
from catfree.adapters.tables.tracks._geojson import (
    write_geojson as write_geojson,
)
from catfree.adapters.tables.tracks._movement import (
    to_movement as to_movement,
)
from catfree.adapters.tables.tracks._pedpy import (
    write_pedpy as write_pedpy,
)
from catfree.adapters.tables.tracks._trackeval import (
    write_trackeval as write_trackeval,
)
from catfree.types import GeoReference as GeoReference
