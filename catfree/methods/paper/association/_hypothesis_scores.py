"""The seven signals of the auxiliary score of every hypothesis."""

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.filters import (
    Signal,
    auxiliary_score,
    frames_of_pairs,
    height_consistency,
    implied_height,
    median_residual,
    view_support_ratio,
)
from catfree.geometry._buckets import in_blocks, padded_length
from catfree.geometry.camera import pixels_of_points, rays_of_pixels
from catfree.methods.paper.association._hypotheses import GROUND, HYPOTHESIS_BLOCK, Support
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
) -> Float[np.ndarray, " h"]:
    """Compute the auxiliary score of every hypothesis, without the reconstruction's confidence.

    Args:
        observations: detections in canonical order.
        rig: cameras in the canonical frame.
        position: (H, 3) canonical positions.
        support: support of the positions.
        frame_index: (H,) frame of each position.
        tracklet: (H, C) tracklet of each detection of the group, or -1.

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
    if observations.kept.score is not None:
        total = np.where(present, observations.kept.score[member], 0).sum(axis=1)
        signals[supported, Signal.DETECTOR_CONFIDENCE] = total[supported] / cameras[supported]
    boxes = observations.kept.box[member].astype(position.dtype)
    residual, ratio, consistency = _view_signals(rig, position, boxes, present, support.residual)
    signals[:, Signal.NEGATIVE_MEDIAN_RESIDUAL] = -residual
    signals[:, Signal.VIEW_SUPPORT_RATIO] = ratio
    signals[:, Signal.HEIGHT_CONSISTENCY] = consistency
    signals[:, Signal.TEMPORAL_PERSISTENCE] = frames_of_pairs(frame_index, tracklet)
    length = padded_length(count, SAMPLE_BLOCK)
    padded = np.pad(signals, ((0, length - count), (0, 0)))
    return np.asarray(_score(padded, np.arange(length) < count).score)[:count]


_score = jax.jit(auxiliary_score)


def _view_signals(
    rig: Rig,
    position: Float[np.ndarray, "h 3"],
    boxes: Float[np.ndarray, "h cam 4"],
    present: Bool[np.ndarray, "h cam"],
    residual: Float[np.ndarray, "h cam"],
) -> tuple[Float[np.ndarray, " h"], Float[np.ndarray, " h"], Float[np.ndarray, " h"]]:
    """Median residual, view support ratio and height consistency of every hypothesis."""
    dtype = position.dtype
    count, C = present.shape
    h, c = np.nonzero(np.broadcast_to(rig.registered, present.shape))
    pixel, imaged = pixels_of_points(rig, c, position[h].astype(np.float64))
    inside = np.zeros((count, C), bool)
    inside[h, c] = imaged & ((pixel >= 0) & (pixel < rig.image_size[c])).all(-1)
    h, c = np.nonzero(present)
    top = np.stack([(boxes[h, c, 0] + boxes[h, c, 2]) / 2, boxes[h, c, 1]], -1)
    ray = np.zeros((count, C, 3), dtype)
    ray[h, c] = rays_of_pixels(rig, c, top.astype(np.float64))
    center = np.where(rig.registered[:, None], np.asarray(rig.centers), 0).astype(dtype)
    return in_blocks(
        lambda *rows: _view_block(center, *rows),
        (position, ray, present, inside, residual),
        HYPOTHESIS_BLOCK,
    )


@jax.jit
def _view_block(
    center: Float[Array, "cam 3"],
    position: Float[Array, "h 3"],
    ray: Float[Array, "h cam 3"],
    present: Bool[Array, "h cam"],
    inside: Bool[Array, "h cam"],
    residual: Float[Array, "h cam"],
) -> tuple[Float[Array, " h"], Float[Array, " h"], Float[Array, " h"]]:
    def measure(
        position: Array, ray: Array, present: Array, inside: Array, residual: Array
    ) -> tuple[Array, Array, Array]:
        heights = jax.vmap(implied_height, (0, 0, None, None, None))(
            center, ray, position, GROUND.normal, GROUND.offset
        )
        return (
            median_residual(residual, present),
            view_support_ratio(present, inside),
            height_consistency(heights, present),
        )

    return jax.vmap(measure)(position, ray, present, inside, residual)
