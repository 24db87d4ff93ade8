"""Estimate when the person of a track was present, as a two-state Markov chain."""

import numpy as np
from scipy.special import expit

from catfree.methods.evidence.track._tracking import Trails


def presence(trails: Trails, evidence: np.ndarray, entry: float, leave: float) -> np.ndarray:
    """Posterior probability that the person of each row is present, from a two-state chain.

    In the on state, a frame adds its evidence; switching on costs `entry` and switching off costs
    `leave` (both log-odds). A track with less total evidence than the entry cost is never on.

    Args:
        trails: rows sorted by track and frame.
        evidence: (M,) log-odds of each row.
        entry: cost of appearing.
        leave: cost of disappearing before the track ends.

    Returns:
        (M,) probability.
    """
    if len(trails) == 0:
        return np.zeros(0)
    new = np.r_[True, np.diff(trails.track) != 0]
    track = np.cumsum(new) - 1
    start = np.flatnonzero(new)
    column = np.arange(len(trails)) - start[track]
    table = np.zeros((len(start), column.max() + 1))
    real = np.zeros(table.shape, bool)
    table[track, column], real[track, column] = evidence, True
    forward = _chain(table, real, entry, leave)
    # Backward in time, switching on means leaving, so the two costs are exchanged.
    backward = _chain(table[:, ::-1], real[:, ::-1], leave, entry, last=True)[:, ::-1]
    on = forward[..., 0] + backward[..., 0] - table
    off = forward[..., 1] + backward[..., 1]
    return expit(on - off)[track, column]


def _chain(table, real, enter, leave, last=False):
    """Log weights (on, off) of all histories up to each column; rows may start late.

    A track starts off and may end on: at its first row, the on state costs `enter`, but nothing in
    the backward pass (`last`).
    """
    out = np.zeros((*table.shape, 2))
    on = np.full(len(table), 0.0 if last else -enter)
    off = np.zeros(len(table))
    begun = np.zeros(len(table), bool)
    for i in range(table.shape[1]):
        is_real = real[:, i]
        stay_on = np.where(begun, np.logaddexp(on, off - enter), on)
        stay_off = np.where(begun, np.logaddexp(off, on - leave), off)
        on = np.where(is_real, stay_on + table[:, i], on)
        off = np.where(is_real, stay_off, off)
        begun |= is_real
        out[:, i, 0], out[:, i, 1] = on, off
    return out
