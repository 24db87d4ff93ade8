"""Where the cameras stand: from pedestrians alone, from reconstructions, refined with people."""

from catfree.rig.calibrate import calibrate as calibrate
from catfree.rig.pedestrians import (
    Calibration as Calibration,
    refine_with_correspondences as refine_with_correspondences,
    remove_offsets as remove_offsets,
)
