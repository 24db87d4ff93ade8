"""The seven signals of the auxiliary score of every hypothesis."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from catfree.filters import (
    Signal,
    auxiliary_score,
    frames_of_pairs,
    height_consistency,
    implied_height,
    view_support_ratio,
)
from catfree.geometry import project
from catfree.geometry._buckets import coarse_length
from catfree.methods.paper.association._hypotheses import HYPOTHESIS_BLOCK, Support
from catfree.methods.paper.association._observe import Observations
from catfree.types import Rig

SAMPLE_BLOCK = 16384  # rows of the score are padded to this times a power of four


def hypothesis_scores(
    observations: Observations,
    rig: Rig,
    position: Float[np.ndarray, "h 3"],
    support: Support,
    frame_index: Int[np.ndarray, " h"],
    tracklet: Int[np.ndarray, "h cam"],
    *,
    reconstruction_confidence: Float[np.ndarray, " h"] | None = None,
) -> Float[np.ndarray, " h"]:
    """Compute the auxiliary score of every hypothesis.

    Args:
        observations: detections in canonical order.
        rig: cameras in the canonical frame.
        position: (H, 3) canonical positions.
        support: their support.
        frame_index: (H,) frame of each position.
        tracklet: (H, C) tracklet of each detection of the group, or -1.
        reconstruction_confidence: (H,) mean confidence of the reconstruction at the rays' pixels,
            or None if this signal is missing.

    Returns:
        (H,) scores; 0 is average.

    Source:
        Sec. "The Scoring Stage".
    """
    count = len(position)
    if count == 0:
        return np.zeros(0, position.dtype)
    member, present = support.member, support.member >= 0
    cameras = support.cameras
    signals = np.full((count, len(Signal)), np.nan, position.dtype)
    signals[:, Signal.SUPPORTING_RAYS] = cameras
    supported = cameras > 0
    residual = np.nanmedian(support.residual[supported], axis=1)
    signals[supported, Signal.NEGATIVE_MEDIAN_RESIDUAL] = -residual
    if observations.score is not None:
        total = np.where(present, observations.score[member], 0).sum(axis=1)
        signals[supported, Signal.DETECTOR_CONFIDENCE] = total[supported] / cameras[supported]
    boxes = observations.box[member].astype(position.dtype)
    ratio, consistency = _view_signals(rig, position, boxes, present)
    signals[:, Signal.VIEW_SUPPORT_RATIO] = ratio
    signals[:, Signal.HEIGHT_CONSISTENCY] = consistency
    signals[:, Signal.TEMPORAL_PERSISTENCE] = frames_of_pairs(frame_index, tracklet)
    if reconstruction_confidence is not None:
        signals[:, Signal.RECONSTRUCTION_CONFIDENCE] = reconstruction_confidence
    length = coarse_length(count, SAMPLE_BLOCK)
    padded = np.pad(signals, ((0, length - count), (0, 0)))
    return np.asarray(_score(padded, np.arange(length) < count).score)[:count]


_score = jax.jit(auxiliary_score)


def _view_signals(
    rig: Rig,
    position: Float[np.ndarray, "h 3"],
    boxes: Float[np.ndarray, "h cam 4"],
    present: np.ndarray,
) -> tuple[Float[np.ndarray, " h"], Float[np.ndarray, " h"]]:
    """View support ratio and height consistency of every hypothesis."""
    dtype = position.dtype
    cameras = [np.asarray(a, dtype) for a in (rig.K, rig.R, rig.t, rig.image_size)]
    ratio, consistency = np.empty(len(position), dtype), np.empty(len(position), dtype)
    for begin in range(0, len(position), HYPOTHESIS_BLOCK):
        rows = slice(begin, begin + HYPOTHESIS_BLOCK)
        padding = (0, HYPOTHESIS_BLOCK - len(position[rows]))
        block = _view_block(
            *cameras,
            rig.registered,
            np.pad(position[rows], (padding, (0, 0))),
            np.pad(boxes[rows], (padding, (0, 0), (0, 0))),
            np.pad(present[rows], (padding, (0, 0))),
        )
        ratio[rows] = np.asarray(block[0])[: len(position[rows])]
        consistency[rows] = np.asarray(block[1])[: len(position[rows])]
    return ratio, consistency


@jax.jit
def _view_block(
    K: Float[Array, "cam 3 3"],
    R: Float[Array, "cam 3 3"],
    t: Float[Array, "cam 3"],
    image_size: Float[Array, "cam 2"],
    registered: Array,
    position: Float[Array, "h 3"],
    boxes: Float[Array, "h cam 4"],
    present: Array,
) -> tuple[Array, Array]:
    up = jnp.array([0, 0, 1], position.dtype)
    zero = jnp.zeros((), position.dtype)

    def measure(position: Array, boxes: Array, present: Array) -> tuple[Array, Array]:
        pixel, depth = jax.vmap(project, (0, 0, 0, None))(K, R, t, position)
        inside = jnp.all((pixel >= 0) & (pixel < image_size), axis=-1) & (depth > 0) & registered
        heights = jax.vmap(implied_height, (0, 0, 0, 0, None, None, None))(
            K, R, t, boxes, position, up, zero
        )
        return view_support_ratio(present, inside), height_consistency(heights, present)

    return jax.vmap(measure)(position, boxes, present)
