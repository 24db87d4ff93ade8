"""Monitoring of a rig: has a camera moved, is its clock late, is it dead?"""

from catfree.calibration.watching._check import (
    CameraCheck as CameraCheck,
    Check as Check,
    Verdict as Verdict,
    check as check,
)
from catfree.calibration.watching._estimate_clocks import (
    ClockJump as ClockJump,
    Clocks as Clocks,
    estimate_clocks as estimate_clocks,
)
