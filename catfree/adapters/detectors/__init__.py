"""Person detectors."""

from catfree.adapters.detectors._yolo_pose import (
    YoloPoseOnnx as YoloPoseOnnx,
)
from catfree.adapters.detectors._yolox import (
    YoloxOnnx as YoloxOnnx,
)
