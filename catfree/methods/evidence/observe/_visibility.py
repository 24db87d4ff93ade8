"""Expected visibility of people: occlusion, image borders, and the learned detection rate."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from catfree.geometry._person import ASPECT
from catfree.methods.evidence.observe._views import GroundViews, people_in_cameras
from catfree.settings import EvidenceSettings

ENTRIES = 1 << 17  # boxes compared with regions at a time: fits a cache
COLUMNS = 8  # sampled columns of a box; rows are integrated exactly


def covered_share(region: Array, floor: Array, others: Array, active: Array) -> Float[Array, ""]:
    """Share of a rectangle hidden by boxes that reach lower, that is, by nearer people.

    In each column such a box covers everything below its top edge, so the union is exact.

    Args:
        region: (4,) x1, y1, x2, y2 in pixels.
        floor: () the row that a box must pass to be nearer.
        others: (B, 4) boxes of the same image.
        active: (B,) which boxes to use.

    Returns:
        () share in [0, 1].
    """
    steps = (jnp.arange(COLUMNS, dtype=region.dtype) + 0.5) / COLUMNS
    columns = region[0] + steps * (region[2] - region[0])
    inside = (others[:, :1] <= columns[None, :]) & (columns[None, :] <= others[:, 2:3])
    nearer = active & (others[:, 3] > floor)
    rows = jnp.minimum(others[:, 3], region[3]) - jnp.maximum(others[:, 1], region[1])
    rows = jnp.where(nearer[:, None] & inside, jnp.maximum(rows, 0)[:, None], 0.0)
    height = jnp.maximum(region[3] - region[1], 1e-9)
    return jnp.clip(rows.max(0).mean() / height, 0, 1)


@jax.jit
def covered_feet(box, frame, camera, table, lower_body) -> Float[Array, " box"]:
    """Share of the lower part of each box that is hidden by boxes in front of it."""
    rows = jnp.arange(box.shape[0])

    def one(row_of_box):
        row, box_, f, c = row_of_box
        others = jnp.asarray(table)[jnp.minimum(f, table.shape[0] - 1), c]
        active = (others >= 0) & (others != row) & (f < table.shape[0])
        low = jnp.stack([box_[0], box_[3] - lower_body * (box_[3] - box_[1]), box_[2], box_[3]])
        return covered_share(low, box_[3], box[jnp.maximum(others, 0)], active)

    batch = max(1, ENTRIES // table.shape[2])
    return jax.lax.map(one, (rows, box, frame, camera), batch_size=batch)


class Views(eqx.Module):
    """Predicted visibility of each person in each camera.

    Attributes:
        inside: (H, C) weight in [0, 1] of the part of the body inside the image.
        height: (H, C) predicted box height in pixels.
        cover: (H, C) share hidden by nearer boxes.
        share: (H, C) share of the body inside the image.
    """

    inside: Float[Array | np.ndarray, "person cam"]
    height: Float[Array | np.ndarray, "person cam"]
    cover: Float[Array | np.ndarray, "person cam"]
    share: Float[Array | np.ndarray, "person cam"]


def expected_views(
    state: Float[np.ndarray, "person 3"],
    frame: Int[np.ndarray, " person"],
    member: Int[np.ndarray, "person cam"],
    box: Float[Array | np.ndarray, "box 4"],
    table: Int[Array | np.ndarray, "frame cam slot"],
    views: GroundViews,
    settings: EvidenceSettings,
) -> Views:
    """Predict the box of every person in every camera.

    Args:
        state: (H, 3) position and height in H0.
        frame: (H,) frame index.
        member: (H, C) the person's own detection in each camera or -1; it does not hide the person.
        box: (N, 4) all boxes in pixels.
        table: (F, C, B) rows of each frame and camera.
        views: the cameras.
        settings: for the share of the body that must be in view.

    Returns:
        (H, C) arrays.
    """
    edges, imaged = people_in_cameras(state, views)
    return _expected_views(
        edges, imaged, frame, member, box, table, views.image_size, settings.body_ramp
    )


@jax.jit
def _expected_views(edges, imaged, frame, member, box, table, image_size, ramp) -> Views:
    table, box = jnp.asarray(table), jnp.asarray(box)
    low, high = ramp

    def one(edges, front, f, detection, size, c):
        u, top, bottom = edges
        height = jnp.maximum(bottom - top, 1e-6)
        half = 0.5 * ASPECT * height
        wide = jnp.clip(jnp.minimum(u + half, size[0]) - jnp.maximum(u - half, 0.0), 0)
        tall = jnp.clip(jnp.minimum(bottom, size[1]) - jnp.maximum(top, 0.0), 0)
        share = wide * tall / (2 * half * height)
        inside = jnp.clip((share - low) / (high - low), 0, 1)
        others = table[f, c]
        active = (others >= 0) & (others != detection)
        region = jnp.stack(
            [u - half, jnp.maximum(top, 0.0), u + half, jnp.minimum(bottom, size[1])]
        )
        region = jnp.where(front, region, 0.0)
        cover = covered_share(region, region[3], box[jnp.maximum(others, 0)], active)
        inside, share = (jnp.where(front, x, 0.0) for x in (inside, share))
        return inside, jnp.where(front, height, 1.0), cover, share

    per_camera = jax.vmap(one, in_axes=(0, 0, None, 0, 0, 0))
    cameras = (jnp.asarray(image_size), jnp.arange(len(image_size)))
    inside, height, cover, share = jax.lax.map(
        lambda person: per_camera(person[0], person[1], person[2], person[3], *cameras),
        tuple(map(jnp.asarray, (edges, imaged, frame, member))),
        batch_size=max(1, ENTRIES // (table.shape[1] * table.shape[2])),
    )
    return Views(inside, height, cover, share)


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

    def __call__(self, seen: Views) -> np.ndarray:
        """(H, C) detection probability, including the inside weight."""
        camera = np.arange(self.rate.shape[0])[None, :]
        return np.asarray(seen.inside) * self.rate[camera, *_bins(seen, self.heights, self.covers)]


def _bins(
    seen: Views, heights: Float[np.ndarray, "cam 2"], covers: Float[np.ndarray, "4"]
) -> tuple[np.ndarray, np.ndarray]:
    """The class of height and that of cover of each person in each camera (H, C)."""
    height = (np.asarray(seen.height)[..., None] > heights[None]).sum(-1)
    return height, np.searchsorted(covers, np.asarray(seen.cover))


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
    seen: Views,
    member: np.ndarray,
    heights: Float[np.ndarray, "cam 2"],
    settings: EvidenceSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """Trials and hits (C, 3, 5) of people wholly in view whom other cameras confirm."""
    C = member.shape[1]
    height, cover = _bins(seen, heights, np.array(settings.cover_edges))
    hit = member >= 0
    others = hit.sum(1, keepdims=True) - hit
    trial = (others >= settings.witnesses) & (seen.inside == 1)
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
