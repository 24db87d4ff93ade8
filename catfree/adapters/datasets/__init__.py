"""Data sets, and files of boxes, calibrations and ground truth whose format is found out."""

from catfree.adapters.datasets._detection_files import (
    read_detections as read_detections,
    read_missing_pictures as read_missing_pictures,
)
from catfree.adapters.datasets._ground_truth import (
    GroundTruth as GroundTruth,
    read_ground_truth as read_ground_truth,
)
from catfree.adapters.datasets._multiviewx import (
    read_multiviewx as read_multiviewx,
)
from catfree.adapters.datasets._scenario import (
    read_scenario as read_scenario,
)
from catfree.adapters.datasets._scene_files import (
    read_scene as read_scene,
)
from catfree.adapters.datasets._sequence import (
    MultiViewSequence as MultiViewSequence,
)
from catfree.adapters.datasets._uniform_json import (
    read_uniform_json as read_uniform_json,
)
from catfree.adapters.datasets._wildtrack import (
    read_wildtrack as read_wildtrack,
)
