"""Evaluation against ground truth: detection, tracking, alignment and uncertainty."""

from catfree.evaluation._alignment import (
    LeaveOneOut as LeaveOneOut,
    PositionAlignment as PositionAlignment,
    align_centres as align_centres,
    align_positions as align_positions,
    leave_one_camera_out as leave_one_camera_out,
)
from catfree.evaluation._area import (
    AreaMetrics as AreaMetrics,
    crop as crop,
    detection_metrics_in_area as detection_metrics_in_area,
    inside as inside,
)
from catfree.evaluation._bootstrap import (
    DetectionIntervals as DetectionIntervals,
    Interval as Interval,
    bootstrap as bootstrap,
)
from catfree.evaluation._detection_metrics import (
    DetectionMetrics as DetectionMetrics,
    combine_detection as combine_detection,
    detection_metrics as detection_metrics,
)
from catfree.evaluation._hota import (
    HotaMetrics as HotaMetrics,
    combine_hota as combine_hota,
    hota as hota,
)
from catfree.evaluation._tracking_metrics import (
    TrackingMetrics as TrackingMetrics,
    combine_tracking as combine_tracking,
    tracking_metrics as tracking_metrics,
)
from catfree.evaluation._uncertainty_calibration import (
    CalibrationCurve as CalibrationCurve,
    EllipseCoverage as EllipseCoverage,
    calibration_curve as calibration_curve,
    ellipse_coverage as ellipse_coverage,
    matched_predictions as matched_predictions,
)
