"""Log-odds that a group is a person, from the cameras that see it and those that should."""

from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import uniform_filter
from scipy.special import expit

from catfree.geometry._buckets import in_blocks
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._measurement import Measurements
from catfree.methods.evidence.observe._views import PEOPLE_BLOCKS, GroundViews
from catfree.methods.evidence.observe._visibility import Views, expected_views
from catfree.settings import EvidenceSettings

CELLS = 128  # side of each camera's clutter map, in H0
BEHIND = 8  # cells behind the camera, where rig errors may place a person
SUREST = 0.99  # largest detection probability: a miss never excludes a person
OUTAGE_EXPECTED = 3.0  # expected detections in an empty frame above which it is an outage


class Existence(eqx.Module):
    """Evidence for and against each group.

    Attributes:
        log_odds: (H,) log-odds that a person is present.
        rate: (H, C) detection probability, 0 for cameras without a frame.
        clutter: (N,) ratio of clutter to people at each box.
    """

    log_odds: Float[np.ndarray, " group"]
    rate: Float[np.ndarray, "group cam"]
    clutter: Float[np.ndarray, " box"]


def predict_views(
    state: np.ndarray, frame: np.ndarray, member: np.ndarray, boxes: Boxes, views: GroundViews
) -> Views:
    """Compute `expected_views` on the host."""
    return in_blocks(
        lambda state, frame, member: expected_views(
            state, frame, member, boxes.box, boxes.table, views
        ),
        (state, frame, member),
        *PEOPLE_BLOCKS,
    )


def with_pictures(seen: Views, frame: Int[np.ndarray, " person"], boxes: Boxes) -> Views:
    """Nobody is inside the image of a camera that is known to have no picture of the frame."""
    return replace(seen, inside=np.where(boxes.silent[frame], 0.0, seen.inside))


def delivered(rate: np.ndarray, member: np.ndarray, frame: np.ndarray, boxes: Boxes) -> np.ndarray:
    """(F, C) whether a camera delivered a frame; not if it detects none of many expected people."""
    F, C = len(boxes.frames), member.shape[1]
    expected = np.zeros((F, C))
    strong = (member >= 0).sum(1) >= 2
    np.add.at(expected, frame[strong], rate[strong])
    empty = (boxes.table[:F] >= 0).sum(-1) == 0
    return ~(empty & (expected > OUTAGE_EXPECTED))


def misses(rate: np.ndarray, member: np.ndarray) -> np.ndarray:
    """(H,) sum of log(1 - Pd) over the cameras without a detection."""
    return np.where(member < 0, np.log1p(-np.minimum(rate, SUREST)), 0.0).sum(1)


def clutter_cells(state: np.ndarray, camera: np.ndarray, views: GroundViews) -> np.ndarray:
    """Index of the 1 H0² cell of each box in its camera's ground frame."""
    away = state[:, :2] - views.station[camera]
    ahead = views.heading[camera]
    forward = (away * ahead).sum(1)
    aside = away[:, 0] * ahead[:, 1] - away[:, 1] * ahead[:, 0]
    i = np.clip(np.floor(forward) + BEHIND, 0, CELLS - 1).astype(int)
    j = np.clip(np.floor(aside) + CELLS // 2, 0, CELLS - 1).astype(int)
    return (camera * CELLS + i) * CELLS + j


def judge_groups(
    groups: Groups,
    agreement: np.ndarray,
    measurements: Measurements,
    boxes: Boxes,
    views: GroundViews,
    probability: np.ndarray,
    settings: EvidenceSettings,
) -> Existence:
    """Compute log-odds of every group, learning the clutter ratio by expectation maximization.

    Args:
        groups: the groups.
        agreement: (H,) appearance term.
        measurements: the boxes as likelihoods.
        boxes: the boxes.
        views: the cameras.
        probability: (H, C) detection probability of each group in each camera.
        settings: constants.
    """
    member = groups.member
    is_member = member >= 0
    C = member.shape[1]
    probability = probability * delivered(probability, member, groups.frame, boxes)[groups.frame]
    base = groups.gain + agreement
    if settings.use_misses:
        base = base + misses(probability, member)
    detection_rate = np.maximum(probability, settings.smallest_detection_rate)
    base = base + np.where(is_member, np.log(detection_rate), 0.0).sum(1)

    g, c = np.nonzero(is_member)
    box = member[g, c]
    cell = clutter_cells(np.asarray(measurements.state)[box], c, views)
    clutter = np.full(len(g), settings.clutter_start)
    log_odds = base
    for round_ in range(settings.clutter_rounds + 1):
        log_odds = base - np.bincount(g, np.log(clutter), len(member))
        if round_ == settings.clutter_rounds or not settings.local_clutter:
            break
        p = expit(log_odds)[g]
        shape = (C, CELLS, CELLS)
        person = np.bincount(cell, p, C * CELLS * CELLS).reshape(shape)
        other = np.bincount(cell, 1 - p, C * CELLS * CELLS).reshape(shape)
        ratio = (other.sum((1, 2)) + 1) / (person.sum((1, 2)) + 1)
        near = [9 * uniform_filter(x, 3, mode="constant", axes=(1, 2)) for x in (person, other)]
        pseudo = settings.clutter_pseudo_counts
        smooth = (near[1] + pseudo * ratio[:, None, None]) / (near[0] + pseudo)
        clutter = np.clip(smooth.reshape(-1)[cell], *settings.clutter_range)
    per_box = np.full(len(boxes.frame), settings.clutter_start)
    per_box[box] = clutter
    return Existence(log_odds, probability, per_box)
