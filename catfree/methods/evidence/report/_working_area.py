"""The ground that the rig was built to cover: where its geometry pins an unhidden person down."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from catfree.filters import log_otsu
from catfree.geometry._buckets import coarse_length, in_blocks
from catfree.methods.evidence._gaussian import Information, mean_and_covariance
from catfree.methods.evidence.observe._measurement import Noise
from catfree.methods.evidence.observe._views import PEOPLE_BLOCKS, GroundViews, edges_and_slopes
from catfree.methods.evidence.observe._visibility import Views
from catfree.settings import EvidenceSettings

WHOLE_BODY = 0.95  # share of the body inside an image: a hand or a hat may be outside
SAMPLE_BLOCK = 4096  # positions are padded to this times a power of four

_log_otsu = jax.jit(log_otsu)


@partial(jax.jit)
def _design(state, inside, height, views: GroundViews, noise: Noise):
    def one(state, inside, height, matrix, focal, edge):
        _, slopes = edges_and_slopes(matrix, state)
        variance = (edge * height) ** 2 + (jnp.asarray(noise.angular) * focal) ** 2
        weighted = slopes * (inside / variance)[:, None]
        return weighted.T @ slopes

    cameras = jax.vmap(one, in_axes=(None, 0, 0, 0, 0, 0))
    people = jax.vmap(cameras, in_axes=(0, 0, 0, None, None, None))
    take = jnp.asarray
    info = people(
        state, inside, height, take(views.matrix), take(views.focal), take(noise.edge)
    ).sum(1)
    # A place that nobody sees is vague, not undefined.
    info = info + 1e-6 * jnp.eye(3, dtype=info.dtype)[None]
    flat = Information(info, jnp.zeros_like(state), jnp.zeros_like(state[:, 0]))
    _, covariance = mean_and_covariance(flat, jnp.asarray(noise.spread))
    return jnp.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2)


def design_sigma(
    state: np.ndarray, seen: Views, views: GroundViews, noise: Noise
) -> Float[np.ndarray, " person"]:
    """Ground uncertainty that a person there would have if nobody stood in the way, in H0."""
    return in_blocks(
        lambda *rows: _design(*rows, views, noise),
        (state, seen.inside, seen.height),
        *PEOPLE_BLOCKS,
    )


def in_working_area(
    state: np.ndarray,
    seen: Views,
    views: GroundViews,
    noise: Noise,
    cameras: int,
    settings: EvidenceSettings,
) -> Bool[np.ndarray, " person"]:
    """Which positions lie where the rig can be trusted, judged by the sequence's own people.

    Two signs, both relative to the typical person: the design uncertainty is not far above that of
    the well-seen people (the lower class of a log-Otsu split), and the number of images that hold
    the whole body is not below the typical one by half of the rig (`missing_views`) or more,
    unless there are so many (`enough_views`) that they check each other wherever it is.

    Args:
        state: (n, 3) positions and heights in H0.
        seen: how each camera would see them if nobody stood in the way.
        views: the cameras.
        noise: of their edges.
        cameras: how many of them see anybody at all: what the rig is.
        settings: constants.

    Returns:
        (n,) whether each lies in the area.
    """
    if len(state) == 0:
        return np.zeros(0, bool)
    sigma = design_sigma(state, seen, views, noise)
    sample = np.pad(sigma, (0, coarse_length(len(sigma), SAMPLE_BLOCK) - len(sigma)))
    present = np.arange(len(sample)) < len(sigma)
    typical = np.log(sigma[sigma <= float(_log_otsu(sample, present))]).mean()
    whole = (seen.share >= WHOLE_BODY).sum(1)
    missing = np.median(whole) - whole
    enough = missing < settings.missing_views * cameras
    enough |= whole >= settings.enough_views
    return (np.log(sigma) <= typical + np.log(settings.working_sigma)) & enough
