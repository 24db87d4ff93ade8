"""Weigh each group against clutter and against the cameras that should see it and do not."""

from dataclasses import replace

import numpy as np

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.group._appearance import appearance_log_odds
from catfree.methods.evidence.observe._visibility import (
    count_detections,
    expected_views,
    rate_of_counts,
)
from catfree.methods.evidence.track._existence import judge_groups, with_pictures
from catfree.settings import EvidenceSettings


def weigh_groups(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Learn how often each camera detects people, then the log-odds that each group is one."""
    boxes, groups, heights = state.boxes, state.groups, state.rate.heights
    visibility = expected_views(
        state.place, groups.frame, boxes, state.views, settings, groups.member
    )
    visibility = with_pictures(visibility, groups.frame, boxes)
    counts = count_detections(visibility, groups.member, heights, groups.seeing_cameras, settings)
    rate = rate_of_counts(heights, *counts, settings)
    existence = judge_groups(
        groups, appearance_log_odds(groups, state.ratios), np.asarray(state.measurements.cell),
        boxes, rate(visibility), rate.usual, settings,
    )  # fmt: skip
    return replace(state, rate=rate, existence=existence)
