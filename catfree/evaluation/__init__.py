"""How good the result is: detection, tracking, alignment and uncertainty against ground truth."""

from catfree.evaluation.detection import (
    DetectionMetrics as DetectionMetrics,
    combine_detection as combine_detection,
    detection_metrics as detection_metrics,
)
from catfree.evaluation.hota import (
    HotaMetrics as HotaMetrics,
    combine_hota as combine_hota,
    hota as hota,
)
from catfree.evaluation.tracking import (
    TrackingMetrics as TrackingMetrics,
    combine_tracking as combine_tracking,
    tracking_metrics as tracking_metrics,
)
