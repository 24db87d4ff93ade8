"""Learn how well the embeddings of a sequence identify people."""

from dataclasses import replace

import numpy as np

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.group._appearance import learn_ratios
from catfree.methods.evidence.group._group import group
from catfree.settings import EvidenceSettings
from catfree.types._sampling import evenly_spread


def learn_looks(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Learn the likelihood ratio of embeddings from boxes grouped by position and height.

    Uses as many evenly spread frames as self-calibration.
    """
    boxes, measured = state.boxes, state.measurements
    if boxes.embedding is None:
        return state
    frames = evenly_spread(np.arange(len(boxes.frames)), settings.calibration_frames)
    valid = measured.valid & np.isin(boxes.frame, frames)
    groups = group(boxes, replace(measured, valid=valid), state.noise, settings.gate)
    return replace(state, ratios=learn_ratios(boxes, groups, settings))
