"""Expect people where the tracks so far say that they were."""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from catfree.methods.evidence._state import EvidenceState, with_groups
from catfree.methods.evidence.group._groups import Groups, Priors, no_groups, priors_of
from catfree.methods.evidence.observe._measurement import Noise
from catfree.methods.evidence.track._suppress_overlapping import suppress_overlapping_tracks
from catfree.methods.evidence.track._tracking import Trails
from catfree.settings import EvidenceSettings


def expect_people(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Replace groups and tracks by priors of where people are; without tracks, there are none."""
    alone = suppress_overlapping_tracks(
        state.trails, state.evidence, state.probability > 0.5, settings.personal_space
    )
    priors = track_priors(state.trails, np.flatnonzero(alone), state.groups, state.noise)
    return replace(with_groups(state, no_groups(state.groups.member.shape[1])), priors=priors)


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
