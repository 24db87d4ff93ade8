"""Add the error of the whole map to the reported covariances."""

from dataclasses import replace

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.report._shared_error import shared_covariance
from catfree.settings import EvidenceSettings


def add_pose_errors(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Add the effect of camera pose errors on the whole map to the covariances.

    Such errors do not change relative positions, so they do not affect which are reported.
    """
    if not settings.pose_errors:
        return state
    covariance = state.position_covariance + shared_covariance(state, settings)
    return replace(state, position_covariance=covariance)
