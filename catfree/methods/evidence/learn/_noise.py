"""Learn the noise, systematic offsets and height of people from the data."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.geometry._arrays import MEDIAN_TO_DEVIATION
from catfree.geometry._person import drop_to_height, height_at
from catfree.methods.evidence._gaussian import mean_and_covariance
from catfree.methods.evidence._huber_regression import huber_weight
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.learn._offset_field import offset_field
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._measurement import Measurements, Noise, features_of
from catfree.methods.evidence.observe._sightings import predicted_edges
from catfree.methods.evidence.observe._views import GroundViews
from catfree.settings import EvidenceSettings

LARGEST_CHANGE = 2.0  # factor of noise per round, because groups were made with the old noise
STEP = 2 / np.pi**0.5  # H0; each person uses 4 H0² of ground
SPACING = STEP / 6  # of the lattice that measures this area, to a few percent for one person


def median_height(boxes: Boxes, views: GroundViews) -> float:
    """Median height implied by whole boxes, in units of the views' H0; NaN if there are none.

    The bottom of a box is taken to be below the body, because the place of the visible foot depends
    on the height.
    """
    matrix, inverse = views.matrix[boxes.view], views.ground_inverse[boxes.view]
    place = drop_to_height(inverse, boxes.edges[:, [0, 2]])
    height = height_at(matrix, place, boxes.edges[:, 1])
    depth = (matrix[:, 2, :2] * place).sum(-1) + matrix[:, 2, 3]
    good = boxes.valid & ~boxes.cut.any(1) & (depth > 0) & (height > 0) & np.isfinite(height)
    return float(np.median(height[good])) if good.any() else float("nan")


class LeftOut(NamedTuple):
    """Boxes compared with the person estimated from the other boxes of their group.

    Attributes:
        residual: (n, 3) observed minus predicted edges in pixels of the box's pinhole.
        sd: (n, 3) expected standard deviation of the residuals.
        used: (n, 3) whether the residual is informative about cameras and noise.
    """

    residual: Float[np.ndarray, "n 3"]
    sd: Float[np.ndarray, "n 3"]
    used: Bool[np.ndarray, "n 3"]


def left_out_residuals(
    row: Int[np.ndarray, " n"],
    group: Int[np.ndarray, " n"],
    groups: Groups,
    measurements: Measurements,
    boxes: Boxes,
    views: GroundViews,
    noise: Noise,
) -> LeftOut:
    """Compare boxes, given by row, with the other boxes of their groups."""
    others = jax.tree.map(np.subtract, groups.info[group], measurements.info[row])
    state, covariance = mean_and_covariance(others, noise.spread)
    view = boxes.view[row]
    predicted, slopes = predicted_edges(state, views.matrix[view], views.station[view])
    residual, slopes = boxes.edges[row] - predicted, slopes[..., :3]
    variance = np.einsum("nij,njk,nik->ni", slopes, covariance, slopes)
    used = np.asarray(measurements.used)[row] & np.isfinite(residual).all(1, keepdims=True)
    # Boxes cut at the side are not informative about the usual noise.
    used &= ~boxes.cut[row, :1]
    sd = np.sqrt(measurements.noise[row] ** 2 + variance)
    return LeftOut(residual, sd, used)


def learn_noise(
    noise: Noise,
    groups: Groups,
    measurements: Measurements,
    boxes: Boxes,
    views: GroundViews,
    settings: EvidenceSettings,
) -> tuple[Noise, float]:
    """Learn once from groups with enough cameras, or from groups with two if those are too few.

    Args:
        noise: the current noise.
        groups: groups made with the current noise.
        measurements: the boxes as likelihoods.
        boxes: the boxes.
        views: the cameras.
        settings: constants.

    Returns:
        The learned noise, and the median height in units of the current H0.
    """
    is_member = groups.member >= 0
    cameras, C = is_member.sum(1), groups.member.shape[1]
    strong = np.flatnonzero(cameras >= settings.witnesses)
    if len(strong) < settings.fewest_samples:
        # Pairs are selected for agreement, which biases the noise low, but not learning is worse.
        strong = np.flatnonzero(cameras >= 2)
    if len(strong) < settings.fewest_samples:
        return noise, 1.0
    state, covariance = mean_and_covariance(groups.info[strong], noise.spread)
    heights = state[:, 2]
    center = float(np.median(heights))
    # Adding the posterior variance compensates for the shrinkage of estimates toward their prior.
    sample_spread = deviation_of(heights - center)
    spread = float(np.hypot(sample_spread, np.sqrt(np.median(covariance[:, 2, 2])))) / center
    spread = float(np.clip(spread, *settings.height_spread_range))
    density = crowding(state[:, :2], groups.frame[strong])

    g, c = np.nonzero(is_member[strong])
    row = groups.member[strong][g, c]
    residual, sd, used = left_out_residuals(
        row, strong[g], groups, measurements, boxes, views, noise
    )
    if not used.any():
        return replace(noise, spread=np.asarray(spread), density=np.asarray(density)), center
    features = features_of(boxes, row, views)
    z = (residual - np.einsum("nkf,nkf->nk", features, noise.field[c])) / sd
    field, edge = noise.field, noise.edge.copy()
    if settings.residual_field:
        view = boxes.view[row]
        predicted, slopes = predicted_edges(state[g], views.matrix[view], views.station[view])
        offset, slopes = boxes.edges[row] - predicted, slopes[..., :3]
        # The error sought is common to a camera's boxes, not independent noise of each box.
        common = noise.angular * views.focal[view, None]
        weight = huber_weight(z, deviation_of(z[used])) / (measurements.noise[row] ** 2 - common**2)
        seen = used.any(1) & np.isfinite(offset).all(1) & np.isfinite(slopes).all((1, 2))
        field = offset_field(
            g[seen],
            c[seen],
            offset[seen],
            slopes[seen],
            features[seen],
            np.where(used, weight, 0.0)[seen],
            heights,
            spread=float(noise.spread),
            prior=settings.field_prior,
            cameras=C,
        )
    for camera, k in np.ndindex(C, 3):
        mine = used[:, k] & (c == camera)
        if not mine.any():
            continue
        usual, own = settings.edge_noise[k], edge[camera, k] * change_of_noise(z[mine, k])
        # The mean of a conjugate (scaled inverse chi-squared) prior and the residuals.
        worth = [settings.fewest_samples, mine.sum()]
        learned = np.sqrt(np.average([usual**2, own**2], weights=worth))
        edge[camera, k] = max(learned, settings.least_noise * usual)
    angular = np.clip(noise.angular * change_of_noise(z[used]), *settings.angular_noise_range)
    return (
        Noise(edge, np.asarray(angular), field, np.asarray(spread), np.asarray(density)),
        center,
    )


def change_of_noise(z: Float[np.ndarray, " n"]) -> float:
    """Factor on the noise, limited per round, that brings the deviation of the residuals to 1."""
    return float(np.clip(deviation_of(z), 1 / LARGEST_CHANGE, LARGEST_CHANGE))


def deviation_of(z: Float[np.ndarray, " n"]) -> float:
    """Standard deviation of residuals about 0 from their median size, at least a millionth."""
    return max(MEDIAN_TO_DEVIATION * float(np.median(np.abs(z))), 1e-6)


def crowding(position: Float[np.ndarray, "n 2"], frame: Int[np.ndarray, " n"]) -> float:
    """People per H0² of the ground in use.

    The ground in use is all ground within `STEP` of a position, but at least the ellipse over which
    the positions scatter, because in few frames people have not yet been everywhere. The former is
    measured on a lattice along the principal axes of the positions, so it does not depend on the
    orientation of the scene.

    Args:
        position: (n, 2) positions of all people in all frames, in H0.
        frame: (n,) frame of each position.
    """
    away = position - position.mean(0)
    variance, axes = np.linalg.eigh(away.T @ away / len(position))
    ellipse = 4 * np.pi * np.sqrt(np.maximum(variance, 0).prod())  # if evenly filled
    place = away @ axes / SPACING
    reach = STEP / SPACING
    near = np.arange(-np.ceil(reach), np.ceil(reach) + 1)
    # Points are half a step off the axes, so the sign of the axes does not matter.
    point = np.floor(place)[:, None] + np.stack(np.meshgrid(near, near), -1).reshape(-1, 2)
    used = np.hypot(*np.moveaxis(point + 0.5 - place[:, None], -1, 0)) <= reach
    x, y = point[used].astype(np.int64).T
    cells = np.sort((x << 32) + y, axis=None)  # faster than `numpy.unique`, which hashes
    walked = (1 + np.count_nonzero(np.diff(cells))) * SPACING**2
    people = len(position) / max(len(np.unique(frame)), 1)
    return people / max(walked, ellipse)
