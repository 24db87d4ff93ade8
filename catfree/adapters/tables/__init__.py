"""Tracks and boxes as tables."""

from catfree.adapters.tables._coco import (
    CocoBoxes as CocoBoxes,
    read_coco as read_coco,
)
from catfree.adapters.tables._detections_table import (
    read_detections_parquet as read_detections_parquet,
    write_detections_parquet as write_detections_parquet,
)
from catfree.adapters.tables._motchallenge import (
    MotTable as MotTable,
    read_mot as read_mot,
    write_mot_boxes as write_mot_boxes,
    write_mot_ground as write_mot_ground,
)
from catfree.adapters.tables._track_files import (
    read_tracks as read_tracks,
)
from catfree.adapters.tables._tracks_table import (
    read_tracks_csv as read_tracks_csv,
    read_tracks_parquet as read_tracks_parquet,
    write_tracks_csv as write_tracks_csv,
    write_tracks_parquet as write_tracks_parquet,
)
from catfree.adapters.tables.tracks import (
    GeoReference as GeoReference,
    read_ai_city_tracks as read_ai_city_tracks,
    to_movement as to_movement,
    write_ai_city_tracks as write_ai_city_tracks,
    write_geojson as write_geojson,
    write_pedpy as write_pedpy,
    write_trackeval as write_trackeval,
)
