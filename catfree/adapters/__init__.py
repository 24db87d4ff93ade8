"""Data sets, calibration files, track files, videos and neural networks."""

from catfree.adapters.background._background_detector import (
    BackgroundDetector as BackgroundDetector,
)
from catfree.adapters.calibration_files._ai_city import (
    read_ai_city as read_ai_city,
    write_ai_city as write_ai_city,
)
from catfree.adapters.calibration_files._anipose_toml import (
    read_anipose_toml as read_anipose_toml,
    write_anipose_toml as write_anipose_toml,
)
from catfree.adapters.calibration_files._named_rig import NamedRig as NamedRig
from catfree.adapters.calibration_files._opencv_yaml import (
    read_opencv_yaml as read_opencv_yaml,
    write_opencv_yaml as write_opencv_yaml,
)
from catfree.adapters.calibration_files._projection_matrices import (
    read_mv3dt as read_mv3dt,
    write_mv3dt as write_mv3dt,
)
from catfree.adapters.calibration_files._rig_json import (
    read_rig_json as read_rig_json,
    read_scene_json as read_scene_json,
    write_rig_json as write_rig_json,
    write_scene_json as write_scene_json,
)
from catfree.adapters.calibration_files.colmap._colmap import (
    read_colmap as read_colmap,
    write_colmap_text as write_colmap_text,
)
from catfree.adapters.datasets._detection_files import (
    read_detections as read_detections,
    read_missing_pictures as read_missing_pictures,
)
from catfree.adapters.datasets._ground_truth import (
    GroundTruth as GroundTruth,
    read_ground_truth as read_ground_truth,
)
from catfree.adapters.datasets._multiviewx import read_multiviewx as read_multiviewx
from catfree.adapters.datasets._scenario import read_scenario as read_scenario
from catfree.adapters.datasets._scene_files import read_scene as read_scene
from catfree.adapters.datasets._sequence import MultiViewSequence as MultiViewSequence
from catfree.adapters.datasets._uniform_json import read_uniform_json as read_uniform_json
from catfree.adapters.datasets._wildtrack import read_wildtrack as read_wildtrack
from catfree.adapters.detectors._yolo_pose import YoloPoseOnnx as YoloPoseOnnx
from catfree.adapters.detectors._yolox import YoloxOnnx as YoloxOnnx
from catfree.adapters.embedders._color_embedder import ColorEmbedder as ColorEmbedder
from catfree.adapters.embedders._reid import ReIdOnnx as ReIdOnnx
from catfree.adapters.protocols import (
    BatchDetector as BatchDetector,
    Detector as Detector,
    Embedder as Embedder,
    FittedToCamera as FittedToCamera,
    FrameDetections as FrameDetections,
    GuidedDetector as GuidedDetector,
    RaySource as RaySource,
    Reconstruction as Reconstruction,
    Reconstructor as Reconstructor,
    SceneSource as SceneSource,
    ankles_confirmed as ankles_confirmed,
)
from catfree.adapters.reconstructors._vggt import VggtOnnx as VggtOnnx
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
from catfree.adapters.tables._track_files import read_tracks as read_tracks
from catfree.adapters.tables._tracks_table import (
    read_tracks_csv as read_tracks_csv,
    read_tracks_parquet as read_tracks_parquet,
    write_tracks_csv as write_tracks_csv,
    write_tracks_parquet as write_tracks_parquet,
)
from catfree.adapters.tables.tracks._ai_city_tracks import (
    read_ai_city_tracks as read_ai_city_tracks,
    write_ai_city_tracks as write_ai_city_tracks,
)
from catfree.adapters.tables.tracks._geojson import write_geojson as write_geojson
from catfree.adapters.tables.tracks._movement import to_movement as to_movement
from catfree.adapters.tables.tracks._pedpy import write_pedpy as write_pedpy
from catfree.adapters.tables.tracks._trackeval import write_trackeval as write_trackeval
from catfree.adapters.video._common_clock import on_common_clock as on_common_clock
from catfree.adapters.video._detect_videos import detect_videos as detect_videos
from catfree.adapters.video._synchronized_videos import SynchronizedVideos as SynchronizedVideos
from catfree.adapters.weights._fetch_weights import fetch_weights as fetch_weights
from catfree.adapters.weights._pretrained import pretrained as pretrained
from catfree.adapters.weights._weights_table import (
    WEIGHTS as WEIGHTS,
    Weights as Weights,
)
from catfree.types import GeoReference as GeoReference
