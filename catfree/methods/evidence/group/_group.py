"""Group the boxes of each frame into people by position and height, and optionally appearance."""

from dataclasses import replace

import jax
import numpy as np

from catfree.methods.evidence.group._appearance import PairRatios
from catfree.methods.evidence.group._groups import Groups, Priors
from catfree.methods.evidence.group._merge import merge_boxes
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
    """Group the boxes of every frame, a run of frames at a time.

    Args:
        boxes: the boxes.
        measured: the boxes as likelihoods; invalid ones are left out.
        noise: for the density of people and the spread of their heights.
        gate: largest squared Mahalanobis distance of two boxes that may start or join a group.
        priors: where tracks expect people, if any.
        ratios: compares embeddings; None to use positions and heights alone.

    Returns:
        One group per person and frame, including single boxes, sorted by frame and first member.
    """
    parts = []
    for begin, end in boxes.runs:
        rows = slice(int(boxes.first[begin]), int(boxes.first[end]))
        part = merge_boxes(
            measured.info[rows],
            boxes.frame[rows],
            boxes.camera[rows],
            np.asarray(measured.valid)[rows],
            boxes.table.shape[1],
            float(noise.density),
            float(noise.spread),
            gate,
            ratio=None if ratios is None else ratios.of_boxes(rows),
            priors=None if priors is None else priors.between(begin, end),
        )
        parts.append(replace(part, member=np.where(part.member >= 0, part.member + rows.start, -1)))
    return jax.tree.map(lambda *values: np.concatenate(values), *parts)
