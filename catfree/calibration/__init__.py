"""Camera calibration: from pedestrians alone, from reconstructions, refined with people."""

from catfree.calibration._calibrate import calibrate as calibrate
from catfree.calibration._refine import Refinement as Refinement, refine as refine
from catfree.calibration.people import (
    AnchorCheck as AnchorCheck,
    Calibration as Calibration,
    KnownCamera as KnownCamera,
    KnownDistance as KnownDistance,
    SurveyedPoint as SurveyedPoint,
    anchored as anchored,
    read_anchors as read_anchors,
    refine_with_correspondences as refine_with_correspondences,
    remove_offsets as remove_offsets,
)
from catfree.calibration.reconstructions._aggregate import (
    Aggregate as Aggregate,
    Spread as Spread,
    aggregate as aggregate,
)
from catfree.calibration.reconstructions._ground import Ground as Ground, find_ground as find_ground
from catfree.calibration.reconstructions._ground_evidence import GroundCandidate as GroundCandidate
from catfree.calibration.reconstructions._scene_from_videos import (
    scene_from_videos as scene_from_videos,
)
from catfree.calibration.watching import (
    CameraCheck as CameraCheck,
    Check as Check,
    ClockJump as ClockJump,
    Clocks as Clocks,
    Verdict as Verdict,
    check as check,
    estimate_clocks as estimate_clocks,
)
