"""Choose the positions to report: precise, one person per place, inside the working area."""

from dataclasses import replace

import numpy as np

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.observe._visibility import expected_views
from catfree.methods.evidence.report._sharp_positions import sharp_positions
from catfree.methods.evidence.report._uneven_ground import ground_shift, usual_shift
from catfree.methods.evidence.report._working_area import coverage_of, in_working_area
from catfree.methods.evidence.track._suppress_overlapping import suppress_overlapping_tracks
from catfree.settings import EvidenceSettings
from catfree.types import Fate


def choose_reported(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Keep the rows that are more likely than not a person at the correct place."""
    trails, boxes, views = state.trails, state.boxes, state.views
    shift = usual_shift(trails, ground_shift(trails, state, settings), settings.gap)
    covariance, sharp = sharp_positions(trails.covariance, shift, state.probability, settings)
    alone = suppress_overlapping_tracks(trails, state.evidence, sharp, settings.personal_space)
    rows, coverage = np.flatnonzero(alone), np.full((len(trails), 2), np.nan)
    place, frame = trails.mean[rows, :3], trails.frame[rows]
    visibility = expected_views(place, frame, boxes, views, settings)
    seeing = np.isin(np.arange(visibility.share.shape[1]), boxes.camera)
    coverage[rows] = coverage_of(place, visibility, seeing, views, state.noise, settings)
    covered = np.ones(len(rows), bool)
    if settings.working_area:
        covered = in_working_area(place[:, :2], coverage[rows], int(seeing.sum()), settings)
    fate = np.where(state.probability > 0.5, Fate.UNCERTAINTY_FILTER, Fate.TRACKING)
    fate[sharp] = Fate.SUPPRESSED
    fate[rows] = np.where(covered, Fate.ACCEPTED, Fate.WORKING_AREA)
    return replace(
        state,
        position_covariance=covariance,
        coverage=coverage,
        fate=fate,
        identity=np.where(fate == Fate.ACCEPTED, trails.track, -1),
    )
