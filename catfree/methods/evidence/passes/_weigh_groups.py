"""Weigh each group against clutter and against the cameras that should see it but do not."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.group._appearance import appearance_log_odds
from catfree.methods.evidence.observe._visibility import (
    Views,
    count_detections,
    expected_views,
    rate_of_counts,
)
from catfree.methods.evidence.track._existence import judge_groups, with_pictures
from catfree.settings import EvidenceSettings


def weigh_groups(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Learn each camera's detection rate, then the log-odds that each group is a person."""
    visibility = views_of_groups(state, settings)
    groups, heights = state.groups, state.rate.heights
    counts = count_detections(visibility, groups.member, heights, groups.seeing_cameras, settings)
    state = replace(state, rate=rate_of_counts(heights, *counts, settings))
    return judge(state, visibility, settings)


def views_of_groups(state: EvidenceState, settings: EvidenceSettings) -> Views:
    """Predict how every camera sees the person of each group, (H, C)."""
    frame, own, boxes = state.groups.frame, state.groups.member, state.boxes
    visibility = expected_views(state.place, frame, boxes, state.views, settings, own)
    return with_pictures(visibility, frame, boxes)


def judge(
    state: EvidenceState,
    visibility: Views,
    settings: EvidenceSettings,
    clutter: Float[np.ndarray, "2 cam cells cells"] | None = None,
) -> EvidenceState:
    """Weigh the groups with the detection rate of the state.

    Args:
        state: with groups.
        visibility: result of `views_of_groups`.
        settings: constants and switches.
        clutter: as `judge_groups`.
    """
    agreement = appearance_log_odds(state.groups, state.ratios)
    cell = np.asarray(state.measurements.cell)
    existence = judge_groups(
        state.groups, agreement, cell, state.boxes, state.rate(visibility), state.rate.usual,
        settings, clutter,
    )  # fmt: skip
    return replace(state, existence=existence)
