"""Correct clocks in a rig from people, where a late camera was placed a little off."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from catfree.calibration.people import Calibration, remove_offsets
from catfree.calibration.watching._estimate_clocks import WHOLE_FRAME, estimate_clocks
from catfree.errors import InsufficientDataError
from catfree.settings import Settings
from catfree.types import Detections
from catfree.types._sampling import frame_step

FEWEST_CAMERAS = 3  # two cameras that disagree do not tell which of them is late
ROUNDS = 6  # a rig hides a part of a lag, which shows after the rest is corrected
AGAIN = 0.5  # `WHOLE_FRAME` of a camera that was late before
GAIN = 0.02  # in `_information`, that all corrections together must bring


def synchronize(
    calibration: Calibration,
    detections: Detections,
    settings: Settings,
    refine: Callable[[Detections, Calibration], Calibration],
) -> tuple[Calibration, Detections]:
    """Correct the frame numbers of late cameras by whole frames as long as more boxes fit better.

    Args:
        calibration: the settled rig.
        detections: (N,) the boxes it was refined with.
        settings: of the localization.
        refine: refines a rig with boxes whose frame numbers were corrected.

    Returns:
        The rig, whose `frame_offset` includes the corrections, and the corrected boxes.
    """
    settings = replace(settings, method="evidence")
    frames = np.unique(detections.frame)
    step = frame_step(frames)
    kept = calibration, detections
    least = (1 + GAIN) * _information(calibration)
    for _ in range(ROUNDS):
        if calibration.scene.rig.registered.sum() < FEWEST_CAMERAS:
            break
        try:
            clocks = estimate_clocks(calibration.scene, detections, settings=settings)
        except InsufficientDataError:
            break
        smallest = np.where(calibration.frame_offset == 0, WHOLE_FRAME, AGAIN)
        offset = clocks.whole_offsets(step, smallest)
        if not offset.any():
            break
        moved = remove_offsets(detections, offset)
        refined = refine(moved, calibration)
        calibration = replace(refined, frame_offset=calibration.frame_offset + offset)
        detections = moved
        if _information(refined) >= least:
            kept, least = (calibration, detections), _information(refined)
    return kept


def _information(calibration: Calibration) -> float:
    """Return how well the boxes support the rig: how many fit, over their mean squared residual.

    The residual alone would favor a rig in which a late camera lost most of its boxes.
    """
    return float(calibration.sightings.sum() / max(calibration.residual, 1e-9) ** 2)
