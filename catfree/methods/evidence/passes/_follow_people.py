"""Link groups over time into tracks, and decide when the person of each track was present."""

from dataclasses import replace

import numpy as np
from scipy.special import expit

from catfree.methods.evidence._gaussian import mean_and_covariance
from catfree.methods.evidence._state import EvidenceState, with_tracks
from catfree.methods.evidence.observe._visibility import expected_views
from catfree.methods.evidence.track._existence import misses, with_pictures
from catfree.methods.evidence.track._presence import presence
from catfree.methods.evidence.track._tracking import (
    Trails,
    estimate_motion,
    follow,
    sure_groups,
    unlinked,
)
from catfree.settings import EvidenceSettings


def follow_people(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Track all groups from scratch; without time or tracking, judge each group on its own."""
    groups, log_odds, time = state.groups, state.existence.log_odds, state.boxes.time
    if not state.is_tracked(settings):
        trails = unlinked(
            groups.frame, *mean_and_covariance(groups.info, float(state.noise.spread))
        )
        return with_tracks(state, trails, log_odds, expit(log_odds))
    sure = sure_groups(groups.member, log_odds, groups.seeing_cameras, settings)
    motion = estimate_motion(state.place[sure, :2], groups.frame[sure], time, settings)
    state = replace(state, motion=motion)
    trails = follow(groups, log_odds, state.population(settings))
    evidence = evidence_of_rows(trails, state, settings)
    probability = presence(trails, evidence, settings.change_evidence)
    return with_tracks(state, trails, evidence, probability)


def evidence_of_rows(
    trails: Trails, state: EvidenceState, settings: EvidenceSettings
) -> np.ndarray:
    """(M,) log-odds of each track row; in a gap, those of a person missed by all cameras."""
    evidence = np.zeros(len(trails))
    is_detected = trails.group >= 0
    evidence[is_detected] = state.existence.log_odds[trails.group[is_detected]]
    gaps = np.flatnonzero(~is_detected)
    if len(gaps):
        frame, place = trails.frame[gaps], trails.mean[gaps, :3]
        visibility = expected_views(place, frame, state.boxes, state.views, settings)
        evidence[gaps] = misses(state.rate(with_pictures(visibility, frame, state.boxes)))
    return np.clip(evidence, -settings.evidence_limit, settings.evidence_limit)
