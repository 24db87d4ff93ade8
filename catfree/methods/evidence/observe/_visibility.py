"""Expected visibility of people: occlusion, image borders, and the learned detection rate."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from catfree.geometry._person import ASPECT
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._hidden_shares import hidden_shares
from catfree.methods.evidence.observe._views import GroundViews, people_in_cameras
from catfree.settings import EvidenceSettings

PEOPLE_AT_A_TIME = 1 << 14  # people processed together; 20 MB for seven cameras


class Views(eqx.Module):
    """Predicted visibility of each person in each camera.

    Attributes:
        inside: (H, C) weight in [0, 1] of the part of the body inside the image.
        height: (H, C) predicted box height in pixels.
        cover: (H, C) share hidden by nearer boxes.
        share: (H, C) share of the body inside the image.
    """

    inside: Float[np.ndarray, "person cam"]
    height: Float[np.ndarray, "person cam"]
    cover: Float[np.ndarray, "person cam"]
    share: Float[np.ndarray, "person cam"]


def expected_views(
    state: Float[np.ndarray, "person 3"],
    frame: Int[np.ndarray, " person"],
    boxes: Boxes,
    views: GroundViews,
    settings: EvidenceSettings,
    member: Int[np.ndarray, "person cam"] | None = None,
) -> Views:
    """Predict the visibility of every person in every camera, among the boxes of others.

    Args:
        state: (H, 3) position and height in H0.
        frame: (H,) frame index.
        boxes: all boxes, which may hide the person.
        views: the cameras.
        settings: for the share of the body that must be in view.
        member: (H, C) the person's own box in each camera, which does not hide the person, or -1;
            None for people without boxes.

    Returns:
        (H, C) arrays.
    """
    if len(state) > PEOPLE_AT_A_TIME:
        parts = []
        for begin in range(0, len(state), PEOPLE_AT_A_TIME):
            people = slice(begin, begin + PEOPLE_AT_A_TIME)
            own = None if member is None else member[people]
            parts.append(expected_views(state[people], frame[people], boxes, views, settings, own))
        return jax.tree.map(lambda *values: np.concatenate(values), *parts)
    low, high = settings.body_ramp
    edges, imaged = people_in_cameras(state, views)
    column, head, foot = np.moveaxis(edges, -1, 0)
    height = np.maximum(foot - head, 1e-6)
    half = 0.5 * ASPECT * height
    width, rows = views.image_size.T
    left, right = column - half, column + half
    top, bottom = np.maximum(head, 0), np.minimum(foot, rows)
    wide = np.clip(np.minimum(right, width) - np.maximum(left, 0), 0, None)
    share = wide * np.clip(bottom - top, 0, None) / (2 * half * height)
    share = np.where(imaged, share, 0.0)
    inside = np.clip((share - low) / (high - low), 0, 1)
    cover = np.zeros(imaged.shape)
    who, camera = np.nonzero(share)
    region = np.stack([side[who, camera] for side in (left, top, right, bottom)], -1)
    own_box = np.full(len(who), -1) if member is None else member[who, camera]
    cover[who, camera] = hidden_shares(region, own_box, frame[who], camera, boxes.box, boxes.table)
    return Views(inside, np.where(imaged, height, 1.0), cover, share)


class DetectionRate(eqx.Module):
    """Probability that a camera detects a person in view.

    Attributes:
        heights: (C, 2) box heights that separate the bins, in pixels.
        covers: (4,) hidden shares that separate the bins.
        trials, hits: (C, 3, 5) people who should be detected, and who are, by camera, height and
            cover.
        rate: (C, 3, 5) probability in each bin.
        usual: (C,) mean of the probabilities over the detected people.
    """

    heights: Float[np.ndarray, "cam 2"]
    covers: Float[np.ndarray, "4"]
    trials: Float[np.ndarray, "cam 3 5"]
    hits: Float[np.ndarray, "cam 3 5"]
    rate: Float[np.ndarray, "cam 3 5"]
    usual: Float[np.ndarray, " cam"]

    def __call__(self, visibility: Views) -> np.ndarray:
        """(H, C) detection probability, including the inside weight."""
        bins = _bins(visibility, self.heights, self.covers)
        return visibility.inside * self.rate.ravel()[bins]


def _bins(
    visibility: Views, heights: Float[np.ndarray, "cam 2"], covers: Float[np.ndarray, "4"]
) -> Int[np.ndarray, "person cam"]:
    """The bin of each person in each camera, as a flat index into (C, 3, 5)."""
    low, high = heights.T
    height = (visibility.height > low).astype(int) + (visibility.height > high)
    bins = (np.arange(len(heights)) * 3 + height) * 5
    return bins + np.searchsorted(covers, visibility.cover)


def usual_heights(
    size: np.ndarray, camera: np.ndarray, cameras: int, settings: EvidenceSettings
) -> Float[np.ndarray, "cam 2"]:
    """Box heights (C, 2) that separate small, usual and large people, from boxes (n,)."""
    heights = np.zeros((cameras, 2))
    for c in range(cameras):
        camera_sizes = size[camera == c]
        if len(camera_sizes):
            heights[c] = np.quantile(camera_sizes, settings.height_quantiles)
    return heights


def count_detections(
    visibility: Views,
    member: np.ndarray,
    heights: Float[np.ndarray, "cam 2"],
    cameras: int,
    settings: EvidenceSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """Count trials and hits (C, 3, 5) of people wholly in view whom other cameras confirm.

    Args:
        visibility: (H, C) expected visibility of the people.
        member: (H, C) their boxes, -1 for none.
        heights: (C, 2) box heights that separate the bins, in pixels.
        cameras: number of cameras that see anybody.
        settings: constants.
    """
    hit = member >= 0
    others = hit.sum(1, keepdims=True) - hit
    enough = others >= max(1, min(settings.witnesses, cameras - 1))
    trial = enough & (visibility.inside == 1)
    bins = _bins(visibility, heights, np.array(settings.cover_edges))
    shape = (len(heights), 3, 5)
    trials, hits = (
        np.bincount(bins[counted], minlength=np.prod(shape)).reshape(shape).astype(float)
        for counted in (trial, trial & hit)
    )
    return trials, hits


def rate_of_counts(
    heights: Float[np.ndarray, "cam 2"],
    trials: np.ndarray,
    hits: np.ndarray,
    settings: EvidenceSettings,
) -> DetectionRate:
    """Detection rates from trials and hits (C, 3, 5)."""
    pseudo = settings.fewest_samples
    # Shrink toward the product of camera and cover rates, and those toward the overall rate. A
    # camera that detected nobody is dead, which says nothing about the others.
    alive = hits.any((1, 2))
    hit, tried = hits[alive], trials[alive]
    overall = (hit.sum() + pseudo * settings.detection_rate_start) / (tried.sum() + pseudo)
    by_cover = (hit.sum((0, 1)) + pseudo * overall) / (tried.sum((0, 1)) + pseudo)
    detected = hits.sum((1, 2))
    by_camera = (detected + pseudo * overall) / (trials.sum((1, 2)) + pseudo)
    prior = by_camera[:, None, None] * (by_cover / overall)[None, None]
    low, high = settings.detection_rate_range
    prior = np.clip(prior, low, high)
    shrunk = (hits + pseudo * prior) / (trials + pseudo)
    # Counting, however long, may at most halve the distance to certainty.
    rate = np.clip(shrunk, low / 2, (1 + high) / 2)
    usual = ((hits * rate).sum((1, 2)) + pseudo * by_camera) / (detected + pseudo)
    return DetectionRate(heights, np.array(settings.cover_edges), trials, hits, rate, usual)
