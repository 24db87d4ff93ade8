"""Group the boxes of each frame into people, with tracked people as priors."""

import numpy as np

from catfree.methods.evidence._state import EvidenceState, with_groups
from catfree.methods.evidence.group._group import group
from catfree.methods.evidence.group._groups import Priors, priors_of
from catfree.methods.evidence.track._suppress_overlapping import suppress_overlapping_tracks
from catfree.settings import EvidenceSettings


def group_boxes(
    state: EvidenceState, settings: EvidenceSettings, expected: Priors | None = None
) -> EvidenceState:
    """Group all boxes from scratch, expecting people where the current tracks are.

    Args:
        state: the boxes, and tracks if there are any.
        settings: constants and switches.
        expected: priors of the people; those of `expected_people` if None.
    """
    if expected is None:
        expected = expected_people(state, settings)
    observations = state.boxes, state.measurements, state.noise
    return with_groups(state, group(*observations, settings.gate, expected, state.ratios))


def expected_people(state: EvidenceState, settings: EvidenceSettings) -> Priors:
    """Smoothed positions of tracked people, excluding the measurements of the frame itself."""
    trails, info = state.trails, state.groups.info
    alone = suppress_overlapping_tracks(
        trails, state.evidence, state.probability > 0.5, settings.personal_space
    )
    rows = np.flatnonzero(alone)
    rows = rows[np.lexsort((trails.track[rows], trails.frame[rows]))]
    precision = np.linalg.inv(trails.covariance[rows, :3, :3])
    vector = np.einsum("nij,nj->ni", precision, trails.mean[rows, :3])
    group_of = trails.group[rows]
    is_detected = group_of >= 0
    precision[is_detected] -= info.matrix[group_of[is_detected]]
    vector[is_detected] -= info.vector[group_of[is_detected]]
    return priors_of(trails.frame[rows], precision, vector, state.noise)
