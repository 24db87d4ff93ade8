"""Group the boxes of each frame into people, with the priors of those who are expected."""

from catfree.methods.evidence._state import EvidenceState, with_groups
from catfree.methods.evidence.group._group import group
from catfree.settings import EvidenceSettings


def group_boxes(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Group all boxes anew."""
    observations = state.boxes, state.measurements, state.noise
    return with_groups(state, group(*observations, settings.gate, state.priors, state.ratios))
