"""Grouping of blobs by the expected people they show, to join parts that a pole separates."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from catfree.adapters.background._blob_splitting import ZONES, Expected

# Head and trunk count: legs are thin and often hidden.
UPPER_BODY = ZONES[:3]
# A person is searched for if a quarter of head and trunk is foreground; a blob is part of a person
# if it covers at least half of that.
LEAST_SEEN = 0.25
LEAST_PART = LEAST_SEEN / 2


def group_blobs(
    labels: Int[np.ndarray, "h w"], count: int, expected: Sequence[Expected]
) -> list[tuple[Int[np.ndarray, " b"], list[Expected]]]:
    """Group the blobs that show the same people.

    Args:
        labels: 1-based number of each pixel's blob, 0 for background.
        count: number of blobs.
        expected: the people expected in the picture.

    Returns:
        For each group its blobs, 0-based and ascending, and the people expected there, nearest
        first. Every blob is in one group.
    """
    covered = _covered_shares(labels, count, expected)
    leader = np.arange(count)
    for shares in covered.T:
        leaders = np.unique(leader[shares > LEAST_PART])
        leader[np.isin(leader, leaders[1:])] = leaders[0] if len(leaders) else 0
    order = sorted(range(len(expected)), key=lambda at: -expected[at].v)
    groups = []
    for first in np.unique(leader):
        blobs = np.flatnonzero(leader == first)
        share = covered[blobs].sum(0)
        groups.append((blobs, [expected[at] for at in order if share[at] > LEAST_SEEN]))
    return groups


def _covered_shares(
    labels: Int[np.ndarray, "h w"], count: int, expected: Sequence[Expected]
) -> Float[np.ndarray, "b e"]:
    """Compute the share of each expected person's head and trunk that each blob covers."""
    rows, columns = labels.shape
    covered = np.zeros((count, len(expected)))
    for at, (u, v, height) in enumerate(expected):
        size = 0.0
        for (left, right, top, bottom), share in UPPER_BODY:
            # NumPy takes ten times as long to clip a single number.
            x1, x2 = (min(max(round(u + s * height), 0), columns) for s in (left, right))
            y1, y2 = (min(max(round(v - (1 - s) * height), 0), rows) for s in (top, bottom))
            pixels = np.bincount(labels[y1:y2, x1:x2].ravel(), minlength=count + 1)[1:]
            filled = share * (y2 - y1) * (x2 - x1)
            covered[:, at] += np.minimum(pixels, filled)
            size += filled
        covered[:, at] /= max(size, 1.0)
    return covered
