"""Assign identities to the reported positions."""

from dataclasses import replace

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.track._identify import identify
from catfree.settings import EvidenceSettings


def name_people(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Match the past and the future of every instant, unless there are no tracks."""
    if not state.is_tracked(settings):
        return state
    error = state.position_covariance - state.trails.covariance[:, :2, :2]
    population = state.population(settings)
    identity = identify(state.trails, state.kept, error, state.groups.info, population)
    return replace(state, identity=identity)
