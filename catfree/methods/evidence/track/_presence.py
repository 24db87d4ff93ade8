"""Estimate when the person of a track was present, as a two-state Markov chain."""

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from catfree.methods.evidence.track._tracking import Trails


def presence(trails: Trails, evidence: np.ndarray, change: float) -> np.ndarray:
    """Posterior probability that the person of each row is present, from a two-state chain.

    In the on state, a frame adds its evidence; switching on or off costs `change` (log-odds), and
    the track may end in the on state. A track with less total evidence than that is never on.

    Args:
        trails: rows sorted by track and frame.
        evidence: (M,) log-odds of each row.
        change: cost of appearing, and of disappearing before the track ends.

    Returns:
        (M,) probability.
    """
    if len(trails) == 0:
        return np.zeros(0)
    table, real, place = _by_track(trails, evidence)
    forward = _chain(table, real, change)
    backward = _chain(table[:, ::-1], real[:, ::-1], change, last=True)[:, ::-1]
    on = forward[..., 0] + backward[..., 0] - table
    off = forward[..., 1] + backward[..., 1]
    return expit(on - off)[place]


def step_forward(
    on: np.ndarray, off: np.ndarray, evidence: np.ndarray, change: float
) -> tuple[np.ndarray, np.ndarray]:
    """Log weights of being present or not, one frame later; only their difference counts.

    Args:
        on: (T,) of all histories so far that end present; minus infinity before the first frame.
        off: (T,) of those that do not; 0 before the first frame.
        evidence: (T,) log-odds of the frame.
        change: cost of appearing, and of disappearing.
    """
    on, off = np.logaddexp(on, off - change) + evidence, np.logaddexp(off, on - change)
    most = np.maximum(on, off)
    return on - most, off - most


def later_frames(
    trails: Trails, evidence: np.ndarray, change: float
) -> Float[np.ndarray, "node 2"]:
    """Log weights of being present or not in each row, given its own evidence and later rows.

    Args:
        trails: rows sorted by track and frame.
        evidence: (M,) log-odds of each row.
        change: cost of appearing, and of disappearing.
    """
    if len(trails) == 0:
        return np.zeros((0, 2))
    table, real, place = _by_track(trails, evidence)
    return _chain(table[:, ::-1], real[:, ::-1], change, last=True)[:, ::-1][place]


def _by_track(
    trails: Trails, evidence: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Evidence as a table of tracks and their frames, where it is known, and each row's place."""
    new = np.r_[True, np.diff(trails.track) != 0]
    track = np.cumsum(new) - 1
    column = np.arange(len(trails)) - np.flatnonzero(new)[track]
    table = np.zeros((track[-1] + 1, column.max() + 1))
    real = np.zeros(table.shape, bool)
    table[track, column], real[track, column] = evidence, True
    return table, real, (track, column)


def _chain(table, real, change, last=False):
    """Log weights (on, off) of all histories up to each column; rows may start late.

    A track starts off and may end on: at its first row, the on state costs `change`, but nothing in
    the backward pass (`last`).
    """
    out = np.zeros((*table.shape, 2))
    on = np.full(len(table), 0.0 if last else -change)
    off = np.zeros(len(table))
    begun = np.zeros(len(table), bool)
    for i in range(table.shape[1]):
        is_real = real[:, i]
        stay_on = np.where(begun, np.logaddexp(on, off - change), on)
        stay_off = np.where(begun, np.logaddexp(off, on - change), off)
        on = np.where(is_real, stay_on + table[:, i], on)
        off = np.where(is_real, stay_off, off)
        begun |= is_real
        out[:, i, 0], out[:, i, 1] = on, off
    return out
