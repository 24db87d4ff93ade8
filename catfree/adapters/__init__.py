"""Foreign things in and out: data sets, calibration files, track files, and neural networks."""

from catfree.adapters.anipose_toml import (
    read_anipose_toml as read_anipose_toml,
    write_anipose_toml as write_anipose_toml,
)
from catfree.adapters.background import BackgroundDetector as BackgroundDetector
from catfree.adapters.colmap import (
    read_colmap as read_colmap,
    write_colmap_text as write_colmap_text,
)
from catfree.adapters.color import ColorEmbedder as ColorEmbedder
from catfree.adapters.detect import detect_videos as detect_videos
from catfree.adapters.motchallenge import (
    MotTable as MotTable,
    read_mot as read_mot,
    write_mot_boxes as write_mot_boxes,
    write_mot_ground as write_mot_ground,
)
from catfree.adapters.multiviewx import read_multiviewx as read_multiviewx
from catfree.adapters.named_rig import NamedRig as NamedRig
from catfree.adapters.opencv_yaml import (
    read_opencv_yaml as read_opencv_yaml,
    write_opencv_yaml as write_opencv_yaml,
)
from catfree.adapters.protocols import (
    BatchDetector as BatchDetector,
    Detector as Detector,
    Embedder as Embedder,
    FittedToCamera as FittedToCamera,
    FrameDetections as FrameDetections,
    GuidedDetector as GuidedDetector,
    Reconstruction as Reconstruction,
    Reconstructor as Reconstructor,
    ankles_confirmed as ankles_confirmed,
)
from catfree.adapters.reid import ReIdOnnx as ReIdOnnx
from catfree.adapters.rig_json import (
    read_rig_json as read_rig_json,
    read_scene_json as read_scene_json,
    write_rig_json as write_rig_json,
    write_scene_json as write_scene_json,
)
from catfree.adapters.scenario import read_scenario as read_scenario
from catfree.adapters.sequence import MultiViewSequence as MultiViewSequence
from catfree.adapters.tracks_table import (
    read_tracks_csv as read_tracks_csv,
    write_tracks_csv as write_tracks_csv,
    write_tracks_parquet as write_tracks_parquet,
)
from catfree.adapters.uniform_json import read_uniform_json as read_uniform_json
from catfree.adapters.vggt import VggtOnnx as VggtOnnx
from catfree.adapters.video import SynchronizedVideos as SynchronizedVideos
from catfree.adapters.wildtrack import read_wildtrack as read_wildtrack
from catfree.adapters.yolo_pose import YoloPoseOnnx as YoloPoseOnnx
from catfree.adapters.yolox import YoloxOnnx as YoloxOnnx
