"""Where the cameras stand: from pedestrians alone, from reconstructions, refined with people."""

# From above: it opens videos, but callers know it by this name.
from catfree.reconstruction import scene_from_videos as scene_from_videos
from catfree.rig.aggregate import (
    Aggregate as Aggregate,
    Spread as Spread,
    aggregate as aggregate,
)
from catfree.rig.calibrate import calibrate as calibrate
from catfree.rig.ground import Ground as Ground, find_ground as find_ground
from catfree.rig.ground_evidence import GroundCandidate as GroundCandidate
from catfree.rig.pedestrians import (
    Calibration as Calibration,
    refine_with_correspondences as refine_with_correspondences,
    remove_offsets as remove_offsets,
)
from catfree.rig.refine import Refinement as Refinement, refine as refine
