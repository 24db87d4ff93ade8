"""Walking velocities of tracks, from the positions before and after."""

import numpy as np
from jaxtyping import Float, Int


def difference_velocities(
    track: Int[np.ndarray, " m"],
    frame: Int[np.ndarray, " m"],
    ground_xy: Float[np.ndarray, "m 2"],
    covariance: Float[np.ndarray, "m 2 2"],
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2 2"]]:
    """Estimate the velocity at each position from differences within its track.

    Central differences, one-sided at both ends. Errors of different frames count as independent.

    Args:
        track: (M,) track of each position, -1 for none; at most one position per track and frame.
        frame: (M,) frame numbers.
        ground_xy: (M, 2) positions.
        covariance: (M, 2, 2) of the positions; may be inf.

    Returns:
        (M, 2) velocity in units of the positions per frame number and its covariance (M, 2, 2),
        NaN for positions without a track and for tracks of one position.
    """
    velocity = np.full((len(track), 2), np.nan)
    spread = np.full((len(track), 2, 2), np.nan)
    order = np.lexsort((frame, track))
    joined = (track[order][1:] == track[order][:-1]) & (track[order][1:] >= 0)
    place = np.arange(len(order))
    before = order[place - np.append(False, joined)[: len(order)]]
    after = order[place + np.append(joined, False)[: len(order)]]
    known = before != after
    row, before, after = order[known], before[known], after[known]
    time = (frame[after] - frame[before]).astype(np.float64)
    velocity[row] = (ground_xy[after] - ground_xy[before]) / time[:, None]
    spread[row] = (covariance[after] + covariance[before]) / time[:, None, None] ** 2
    return velocity, spread
