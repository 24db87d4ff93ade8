"""How good the result is: detection, tracking, alignment and uncertainty against ground truth."""

from catfree.evaluation.detection import (
    DetectionMetrics as DetectionMetrics,
    combine_detection as combine_detection,
    detection_metrics as detection_metrics,
)
