"""A metric camera rig from pedestrians alone."""

from catfree.rig.pedestrians.calibrate import (
    Calibration as Calibration,
    calibrate as calibrate,
)
from catfree.rig.pedestrians.correspondences import (
    refine_with_correspondences as refine_with_correspondences,
)
from catfree.rig.pedestrians.offsets import remove_offsets as remove_offsets
from catfree.rig.pedestrians.second_chance import (
    confirm as confirm,
    places_for as places_for,
    reconsider as reconsider,
    without_camera as without_camera,
    without_vague_cameras as without_vague_cameras,
)
from catfree.settings import CalibrationSettings as CalibrationSettings
