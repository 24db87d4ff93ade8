"""Estimate when the person of a track was present, as a two-state Markov chain."""

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from catfree.methods.evidence.track._tracking import Trails


def presence(
    trails: Trails,
    evidence: np.ndarray,
    change: float,
    forward: Float[np.ndarray, "node 2"] | None = None,
) -> np.ndarray:
    """Posterior probability that the person of each row is present, from a two-state chain.

    In the on state, a frame adds its evidence; switching on or off costs `change` (log-odds), and
    the track may end in the on state. A track whose total evidence is below `change` is never on.

    Args:
        trails: rows sorted by track and frame.
        evidence: (M,) log-odds of each row.
        change: cost of appearing, and of disappearing before the track ends.
        forward: (M, 2) `chain_weights`, if earlier rows are known.

    Returns:
        (M,) probability.
    """
    if forward is None:
        forward = chain_weights(trails, evidence, change)
    backward = chain_weights(trails, evidence, change, last=True)
    on, off = (forward + backward).T
    return expit(on - off - evidence)


def step_forward(
    on: np.ndarray, off: np.ndarray, evidence: np.ndarray, change: float
) -> tuple[np.ndarray, np.ndarray]:
    """Advance the log weights of being present or not by one frame; only their difference counts.

    Args:
        on: (T,) log weight of all histories that end present; minus infinity before the first
            frame.
        off: (T,) log weight of the others; 0 before the first frame.
        evidence: (T,) log-odds of the frame.
        change: cost of appearing, and of disappearing.
    """
    on, off = np.logaddexp(on, off - change) + evidence, np.logaddexp(off, on - change)
    most = np.maximum(on, off)
    return on - most, off - most


def chain_weights(
    trails: Trails, evidence: np.ndarray, change: float, *, last: bool = False
) -> Float[np.ndarray, "node 2"]:
    """Log weights of being present or not in each row, given its own evidence and earlier rows.

    A track starts off and may end on: at its first row, the on state costs `change`, but nothing in
    the backward pass.

    Args:
        trails: rows sorted by track and frame.
        evidence: (M,) log-odds of each row.
        change: cost of appearing, and of disappearing.
        last: use later rows instead of earlier ones.

    Returns:
        (M, 2) on and off; only their difference counts, see `step_forward`.
    """
    weights = np.zeros((len(trails), 2))
    _, begin, length = np.unique(trails.track, return_index=True, return_counts=True)
    longest = np.argsort(-length, kind="stable")
    begin, length = begin[longest], length[longest]
    on, off = np.full(len(begin), 0.0 if last else -change), np.zeros(len(begin))
    for step in range(int(length.max(initial=0))):
        active = np.count_nonzero(length > step)  # sorted, so these are the first ones
        row = begin[:active] + (length[:active] - 1 - step if last else step)
        on, off = on[:active], off[:active]
        if step == 0:
            on = on + evidence[row]
        else:
            on, off = step_forward(on, off, evidence[row], change)
        weights[row, 0], weights[row, 1] = on, off
    return weights
