"""Non-maximum suppression of a detector's raw boxes."""

import numpy as np
from jaxtyping import Float, Int


def box_overlap(
    first: Float[np.ndarray, "n 4"], second: Float[np.ndarray, "m 4"]
) -> Float[np.ndarray, "n m"]:
    """Compute the intersection over union of boxes xyxy; 0 for boxes without area."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    intersection = np.clip(high - low, 0, None).prod(axis=-1)
    area = [np.clip(box[:, 2:] - box[:, :2], 0, None).prod(axis=-1) for box in (first, second)]
    union = area[0][:, None] + area[1][None, :] - intersection
    return np.divide(intersection, union, out=np.zeros_like(intersection), where=union > 0)


def suppress_boxes(
    box: Float[np.ndarray, "n 4"],
    score: Float[np.ndarray, " n"],
    maximum_overlap: float,
    window: Int[np.ndarray, " n"],
    maximum_overlap_across: float,
) -> Int[np.ndarray, " k"]:
    """Greedily drop boxes that overlap a better kept box too much.

    OpenCV's suppression has a single limit and no notion of windows.

    Args:
        box: (n, 4) xyxy in pixels.
        score: (n,) higher is better; ties keep the earlier row.
        maximum_overlap: largest IoU of two kept boxes of one window.
        window: (n,) the window of the picture in which each box was found.
        maximum_overlap_across: largest IoU of two kept boxes of different windows.

    Returns:
        (k,) rows to keep, best first.
    """
    order = np.argsort(-score, kind="stable")
    keep = []
    while order.size:
        best, others = order[0], order[1:]
        keep.append(best)
        limit = np.where(window[others] == window[best], maximum_overlap, maximum_overlap_across)
        order = others[box_overlap(box[best][None, :], box[others])[0] <= limit]
    return np.array(keep, np.int64)
