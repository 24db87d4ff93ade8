"""Match the tracks of two neighboring shards in the frames of both."""

import math

import numpy as np
from jaxtyping import Int

from catfree._run._stitch import best_assignment
from catfree.types import Tracks
from catfree.types._sampling import equal_pairs

# Two positions of one person rest on the same boxes, so they are closer than this in all but one of
# a thousand frames.
GATE = -2 * math.log(0.001)


def match_tracks(
    earlier: Tracks, later: Tracks
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Find the pairs of tracks that are one person.

    The gain of a pair sums, over the frames of both tracks, by how much the squared Mahalanobis
    distance is smaller than the gate. A one-to-one assignment maximizes the sum of gains.

    Args:
        earlier: positions of the earlier shard in the frames of both.
        later: positions of the later shard.

    Returns:
        The identities of each pair in the two shards, in order of the first.
    """
    earlier, later = (tracks[tracks.track_id >= 0] for tracks in (earlier, later))
    i, j = equal_pairs(earlier.frame, later.frame)
    if not len(i):
        return i, j
    offset = later.ground_xy[j] - earlier.ground_xy[i]
    spread = later.covariance[j] + earlier.covariance[i]
    solved = np.linalg.solve(spread, offset[..., None])[..., 0]
    gain = GATE - (offset * solved).sum(-1)
    names, a = np.unique(earlier.track_id, return_inverse=True)
    others, b = np.unique(later.track_id, return_inverse=True)
    total = np.zeros((len(names), len(others)))
    # One frame far apart, as after an identity switch, outweighs at most one frame together.
    np.add.at(total, (a[i], b[j]), np.maximum(gain, -GATE))
    one, two = np.nonzero(total > 0)
    before, after = best_assignment(one, two, total[one, two], max(total.shape))
    return names[before], others[after]
