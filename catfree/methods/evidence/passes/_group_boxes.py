"""Group the boxes of each frame into people, with the tracks so far as priors."""

import numpy as np
from jaxtyping import Int

from catfree.methods.evidence._state import EvidenceState, with_groups
from catfree.methods.evidence.group._group import group
from catfree.methods.evidence.group._groups import Groups, Priors, priors_of
from catfree.methods.evidence.observe._measurement import Noise
from catfree.methods.evidence.track._suppress_overlapping import suppress_overlapping_tracks
from catfree.methods.evidence.track._tracking import Trails
from catfree.settings import EvidenceSettings


def group_boxes(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Group all boxes anew; where tracks exist, people are expected where these are."""
    priors = None
    if len(state.trails):
        alone = suppress_overlapping_tracks(
            state.trails, state.evidence, state.probability > 0.5, settings.personal_space
        )
        priors = track_priors(state.trails, np.flatnonzero(alone), state.groups, state.noise)
    observations = state.boxes, state.measurements, state.noise
    return with_groups(state, group(*observations, settings.gate, priors, state.ratios))


def track_priors(
    trails: Trails, rows: Int[np.ndarray, " prior"], groups: Groups, noise: Noise
) -> Priors:
    """Smoothed positions of rows of tracks, without the measurements of the frame itself."""
    rows = rows[np.lexsort((trails.track[rows], trails.frame[rows]))]
    precision = np.linalg.inv(trails.covariance[rows, :3, :3])
    vector = np.einsum("nij,nj->ni", precision, trails.mean[rows, :3])
    group = trails.group[rows]
    is_detected = group >= 0
    precision[is_detected] -= groups.info.matrix[group[is_detected]]
    vector[is_detected] -= groups.info.vector[group[is_detected]]
    density, spread = float(noise.density), float(noise.spread)
    return priors_of(trails.frame[rows], precision, vector, density, spread)
