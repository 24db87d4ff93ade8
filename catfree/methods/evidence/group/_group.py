"""Group the boxes of each frame into people by position and height, and optionally appearance."""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float

from catfree.geometry._buckets import fine_length
from catfree.methods.evidence._gaussian import Information
from catfree.methods.evidence.group._appearance import PairRatios, group_agreement
from catfree.methods.evidence.group._groups import Groups, Priors
from catfree.methods.evidence.group._merge import associate
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._measurement import Measurements, Noise


def group(
    boxes: Boxes,
    measured: Measurements,
    noise: Noise,
    gate: float,
    priors: Priors | None = None,
    ratios: PairRatios | None = None,
) -> Groups:
    """Run `associate` by position and height, and by looks if there are `ratios` of them."""
    if ratios is not None:
        return _group_by_looks(boxes, measured, noise, gate, priors, ratios)
    return associate(
        measured.info,
        np.asarray(measured.state)[:, :2],
        np.asarray(measured.position_covariance),
        np.minimum(boxes.frame, len(boxes.frames) - 1),
        boxes.camera,
        np.asarray(measured.valid),
        boxes.table.shape[1],
        float(noise.density),
        float(noise.spread),
        gate,
        priors=priors,
    )


def _group_by_looks(
    boxes: Boxes,
    measured: Measurements,
    noise: Noise,
    gate: float,
    priors: Priors | None,
    ratios: PairRatios,
) -> Groups:
    """Run `associate` block by block, which limits the size of its tables."""
    parts = []
    for index, (begin, end) in enumerate(ratios.blocks):
        low, high = int(boxes.first[begin]), int(boxes.first[end])
        length = fine_length(high - low)

        def rows(values, low=low, high=high, length=length):
            out = np.zeros((length, *values.shape[1:]), values.dtype)
            out[: high - low] = values[low:high]
            return out

        slot = rows(ratios.appearance.slot)
        slot[: high - low, 0] -= begin
        info = measured.info
        block_priors = None
        if priors is not None:
            chosen = (priors.frame >= begin) & (priors.frame < end)
            block_priors = Priors(
                priors.frame[chosen], priors.mean[chosen], priors.covariance[chosen]
            )
        part = associate(
            Information(rows(info.matrix), rows(info.vector), rows(info.constant)),
            rows(measured.state)[:, :2],
            rows(measured.position_covariance),
            rows(boxes.frame),
            rows(boxes.camera),
            rows(np.asarray(measured.valid)),
            boxes.table.shape[1],
            float(noise.density),
            float(noise.spread),
            gate,
            ratios[index],
            slot,
            block_priors,
        )
        member = np.where(part.member >= 0, part.member + low, -1)
        parts.append(replace(part, member=member))
    return jax.tree.map(lambda *values: np.concatenate(values), *parts)


def appearance_log_odds(groups: Groups, ratios: PairRatios | None) -> Float[np.ndarray, " group"]:
    """Appearance log-odds of each group: the mean pairwise ratio times the k - 1 new boxes."""
    if ratios is None:
        return np.zeros(len(groups))
    count = (groups.member >= 0).sum(1)
    pairs = np.maximum(count * (count - 1) / 2, 1)
    mean = group_agreement(ratios.likeness, ratios.appearance, groups.member) / pairs
    return ratios.weight * (count - 1) * mean
