"""Register a metric camera rig from pedestrians alone."""

from catfree.calibration.people._anchored import anchored as anchored
from catfree.calibration.people._camera_search import (
    confirm as confirm,
    doubtful_cameras as doubtful_cameras,
    place_late_camera as place_late_camera,
    reconsider as reconsider,
    without_camera as without_camera,
    without_vague_cameras as without_vague_cameras,
)
from catfree.calibration.people._correspondences import (
    refine_with_correspondences as refine_with_correspondences,
)
from catfree.calibration.people._register import (
    Calibration as Calibration,
    register as register,
)
from catfree.calibration.people.anchors._anchors import (
    Anchor as Anchor,
    AnchorCheck as AnchorCheck,
    KnownCamera as KnownCamera,
    KnownDistance as KnownDistance,
    SurveyedPoint as SurveyedPoint,
    read_anchors as read_anchors,
    resolve_anchors as resolve_anchors,
)
from catfree.calibration.people.search._clock_offsets import remove_offsets as remove_offsets
