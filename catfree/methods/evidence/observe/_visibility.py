"""Expected visibility of people: occlusion, image borders, and the learned detection rate."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from catfree.geometry._person import ASPECT
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._views import GroundViews, people_in_cameras
from catfree.settings import EvidenceSettings

BOXES_AT_A_TIME = 1 << 20  # compared with regions: 8 MB for each number that is kept of a pair
COLUMNS = 8  # sampled columns of a box; rows are integrated exactly


def hidden_shares(
    region: Float[np.ndarray, "n 4"],
    own_box: Int[np.ndarray, " n"],
    frame: Int[np.ndarray, " n"],
    camera: Int[np.ndarray, " n"],
    box: Float[np.ndarray, "box 4"],
    table: Int[np.ndarray, "frame cam slot"],
) -> Float[np.ndarray, " n"]:
    """Share of each rectangle hidden by boxes that reach lower, that is, by nearer people.

    In each column such a box covers everything below its top edge, so the union is exact.

    Args:
        region: (n, 4) x1, y1, x2, y2 in pixels.
        own_box: (n,) the box that does not hide it, or -1.
        frame: (n,) frame index.
        camera: (n,) camera.
        box: (N, 4) all boxes in pixels.
        table: (F, C, B) rows of each frame and camera, -1 for none.

    Returns:
        (n,) shares in [0, 1].
    """
    left, top, right, bottom = box.T
    bottoms = np.append(bottom, -np.inf)[table]
    shares = np.zeros(len(region))
    at_a_time = max(1, BOXES_AT_A_TIME // table.shape[2])
    steps = (np.arange(COLUMNS) + 0.5) / COLUMNS
    for first in range(0, len(region), at_a_time):
        part = slice(first, first + at_a_time)
        x1, y1, x2, y2 = region[part].T
        picture = frame[part], camera[part]
        row, slot = np.nonzero(bottoms[picture] > y2[:, None])
        near = table[picture][row, slot]
        overlap = (top[near] < y2[row]) & (left[near] <= x2[row]) & (right[near] >= x1[row])
        overlap &= near != own_box[part][row]
        row, near = row[overlap], near[overlap]
        if not len(row):
            continue
        column = x1[row, None] + steps * (x2 - x1)[row, None]
        inside = (left[near, None] <= column) & (column <= right[near, None])
        hidden = np.where(inside, (y2[row] - np.maximum(top[near], y1[row]))[:, None], 0.0)
        begin = np.flatnonzero(np.diff(row, prepend=-1))
        hidden, row = np.maximum.reduceat(hidden, begin), row[begin]
        shares[first + row] = hidden.mean(1) / np.maximum(y2 - y1, 1e-9)[row]
    return np.clip(shares, 0, 1)


def covered_feet(
    box: Float[np.ndarray, "box 4"],
    frame: Int[np.ndarray, " box"],
    camera: Int[np.ndarray, " box"],
    table: Int[np.ndarray, "frame cam slot"],
    lower_body: float,
) -> Float[np.ndarray, " box"]:
    """Share of the lower part of each box that is hidden by boxes in front of it.

    Args:
        box: (N, 4) all boxes in pixels.
        frame: (N,) frame index.
        camera: (N,) camera.
        table: (F, C, B) rows of each frame and camera, -1 for none.
        lower_body: share of the height that counts as feet.
    """
    low = box.astype(np.float64)
    low[:, 1] = low[:, 3] - lower_body * (low[:, 3] - low[:, 1])
    return hidden_shares(low, np.arange(len(box)), frame, camera, box, table)


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
    """Predict the box of every person in every camera, among the boxes of others.

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
    region = np.stack([left, top, right, bottom], -1)[who, camera]
    own_box = np.full(len(who), -1) if member is None else member[who, camera]
    cover[who, camera] = hidden_shares(region, own_box, frame[who], camera, boxes.box, boxes.table)
    return Views(inside, np.where(imaged, height, 1.0), cover, share)


class DetectionRate(eqx.Module):
    """Probability that a camera detects a person in view.

    Attributes:
        heights: (C, 2) box heights that separate the bins, in pixels.
        covers: (4,) hidden shares that separate the bins.
        rate: (C, 3, 5) by camera, height and cover.
    """

    heights: Float[np.ndarray, "cam 2"]
    covers: Float[np.ndarray, "4"]
    rate: Float[np.ndarray, "cam 3 5"]

    def __call__(self, visibility: Views) -> np.ndarray:
        """(H, C) detection probability, including the inside weight."""
        camera = np.arange(self.rate.shape[0])[None, :]
        return (
            np.asarray(visibility.inside)
            * self.rate[camera, *_bins(visibility, self.heights, self.covers)]
        )


def _bins(
    visibility: Views, heights: Float[np.ndarray, "cam 2"], covers: Float[np.ndarray, "4"]
) -> tuple[np.ndarray, np.ndarray]:
    """The class of height and that of cover of each person in each camera (H, C)."""
    height = (np.asarray(visibility.height)[..., None] > heights[None]).sum(-1)
    return height, np.searchsorted(covers, np.asarray(visibility.cover))


def usual_heights(
    size: np.ndarray, camera: np.ndarray, cameras: int, settings: EvidenceSettings
) -> Float[np.ndarray, "cam 2"]:
    """Box heights (C, 2) that separate small, usual and large people, of boxes (n,)."""
    heights = np.zeros((cameras, 2))
    for c in range(cameras):
        camera_sizes = size[camera == c]
        if len(camera_sizes):
            heights[c] = np.quantile(camera_sizes, settings.height_quantiles)
    return heights


def rate_before_counting(
    heights: Float[np.ndarray, "cam 2"], settings: EvidenceSettings
) -> DetectionRate:
    """The detection rate that is assumed of every camera as long as nobody was counted."""
    nobody = np.zeros((len(heights), 3, 5))
    return rate_of_counts(heights, nobody, nobody, settings)


def count_detections(
    visibility: Views,
    member: np.ndarray,
    heights: Float[np.ndarray, "cam 2"],
    settings: EvidenceSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """Trials and hits (C, 3, 5) of people wholly in view whom other cameras confirm."""
    C = member.shape[1]
    height, cover = _bins(visibility, heights, np.array(settings.cover_edges))
    hit = member >= 0
    others = hit.sum(1, keepdims=True) - hit
    trial = (others >= settings.witnesses) & (visibility.inside == 1)
    w = trial.astype(float)
    index = (np.broadcast_to(np.arange(C), w.shape), height, cover)
    trials, hits = np.zeros((C, 3, 5)), np.zeros((C, 3, 5))
    np.add.at(trials, index, w)
    np.add.at(hits, index, w * hit)
    return trials, hits


def rate_of_counts(
    heights: Float[np.ndarray, "cam 2"],
    trials: np.ndarray,
    hits: np.ndarray,
    settings: EvidenceSettings,
) -> DetectionRate:
    """Detection rates from trials and hits (C, 3, 5)."""
    pseudo = settings.fewest_samples
    # Shrink towards the product of camera and cover rates, and those towards the overall rate. A
    # camera that detected nobody is dead, which says nothing about the others.
    alive = hits.any((1, 2))
    hit, tried = hits[alive], trials[alive]
    overall = (hit.sum() + pseudo * settings.detection_rate_start) / (tried.sum() + pseudo)
    by_cover = (hit.sum((0, 1)) + pseudo * overall) / (tried.sum((0, 1)) + pseudo)
    by_camera = (hits.sum((1, 2)) + pseudo * overall) / (trials.sum((1, 2)) + pseudo)
    prior = by_camera[:, None, None] * (by_cover / overall)[None, None]
    low, high = settings.detection_rate_range
    prior = np.clip(prior, low, high)
    shrunk = (hits + pseudo * prior) / (trials + pseudo)
    # Counting may halve the distance to certainty and no more, however long it goes on.
    rate = np.clip(shrunk, low / 2, (1 + high) / 2)
    return DetectionRate(heights, np.array(settings.cover_edges), rate)
