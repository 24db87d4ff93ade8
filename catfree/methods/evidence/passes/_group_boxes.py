"""Group the boxes of each frame into people, with the priors of those who are expected."""

from dataclasses import replace

from catfree.methods.evidence._state import EvidenceState, with_groups
from catfree.methods.evidence.group._group import group
from catfree.methods.evidence.group._groups import no_priors
from catfree.settings import EvidenceSettings


def group_boxes(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Group all boxes anew, and forget the priors."""
    observations = state.boxes, state.measurements, state.noise
    groups = group(*observations, settings.gate, state.priors, state.ratios)
    return replace(with_groups(state, groups), priors=no_priors())
