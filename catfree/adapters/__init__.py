"""Data sets, calibration files, track files, videos and neural networks."""

from catfree.adapters.background import (
    BackgroundDetector as BackgroundDetector,
)
from catfree.adapters.calibration_files import (
    NamedRig as NamedRig,
    read_ai_city as read_ai_city,
    read_anipose_toml as read_anipose_toml,
    read_colmap as read_colmap,
    read_mv3dt as read_mv3dt,
    read_opencv_yaml as read_opencv_yaml,
    read_rig_json as read_rig_json,
    read_scene_json as read_scene_json,
    write_ai_city as write_ai_city,
    write_anipose_toml as write_anipose_toml,
    write_colmap_text as write_colmap_text,
    write_mv3dt as write_mv3dt,
    write_opencv_yaml as write_opencv_yaml,
    write_rig_json as write_rig_json,
    write_scene_json as write_scene_json,
)
from catfree.adapters.datasets import (
    GroundTruth as GroundTruth,
    MultiViewSequence as MultiViewSequence,
    read_detections as read_detections,
    read_ground_truth as read_ground_truth,
    read_multiviewx as read_multiviewx,
    read_scenario as read_scenario,
    read_scene as read_scene,
    read_uniform_json as read_uniform_json,
    read_wildtrack as read_wildtrack,
)
from catfree.adapters.detectors import (
    YoloPoseOnnx as YoloPoseOnnx,
    YoloxOnnx as YoloxOnnx,
)
from catfree.adapters.embedders import (
    ColorEmbedder as ColorEmbedder,
    ReIdOnnx as ReIdOnnx,
)
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
from catfree.adapters.reconstructors import (
    VggtOnnx as VggtOnnx,
)
from catfree.adapters.tables import (
    CocoBoxes as CocoBoxes,
    GeoReference as GeoReference,
    MotTable as MotTable,
    read_ai_city_tracks as read_ai_city_tracks,
    read_coco as read_coco,
    read_detections_parquet as read_detections_parquet,
    read_mot as read_mot,
    read_tracks as read_tracks,
    read_tracks_csv as read_tracks_csv,
    read_tracks_parquet as read_tracks_parquet,
    to_movement as to_movement,
    write_ai_city_tracks as write_ai_city_tracks,
    write_detections_parquet as write_detections_parquet,
    write_geojson as write_geojson,
    write_mot_boxes as write_mot_boxes,
    write_mot_ground as write_mot_ground,
    write_pedpy as write_pedpy,
    write_trackeval as write_trackeval,
    write_tracks_csv as write_tracks_csv,
    write_tracks_parquet as write_tracks_parquet,
)
from catfree.adapters.video import (
    SynchronizedVideos as SynchronizedVideos,
    detect_videos as detect_videos,
    on_common_clock as on_common_clock,
)
from catfree.adapters.weights import (
    WEIGHTS as WEIGHTS,
    Weights as Weights,
    fetch_weights as fetch_weights,
    pretrained as pretrained,
)
