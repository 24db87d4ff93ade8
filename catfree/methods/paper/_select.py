"""The filters in the order of the paper: gates, persistence, suppression, recovery."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from catfree.filters._gates import select
from catfree.filters._suppression import outside, suppress
from catfree.filters._temporal import temporally_consistent
from catfree.geometry._buckets import padded_length
from catfree.settings import SelectionSettings
from catfree.types import Fate

SAMPLE_BLOCK = 16384  # samples of a sequence are padded to this times a power of four
FRAME_BLOCK = 64  # maximum number of frames per call of the suppression
PAIRS_BLOCK = 1 << 22  # maximum number of pairs of candidates in a call for several frames
PLACES_BLOCK = 64  # candidates per frame are padded to this times a power of two


class Hypotheses(NamedTuple):
    """Input of the filters, one row per hypothesis; lengths are shares of E.

    Attributes:
        frame_index: (H,) index of the frame.
        ground_xy: (H, 2) position on the ground.
        ground_distance: (H,) distance g of the free 3-D position to the ground.
        rms_angle: (H,) RMS angular residual of the group's own rays, radians.
        sigma: (H,) ground uncertainty, inf below two cameras.
        weight: (H,) weighted camera support.
        cameras: (H,) supporting cameras.
        tracklet: (H, C) tracklet of each detection of the group, or -1.
        supporting_tracklet: (H, C) tracklet of each supporting detection, or -1.
        score: (H,) auxiliary score.
    """

    frame_index: Int[np.ndarray, " h"]
    ground_xy: Float[np.ndarray, "h 2"]
    ground_distance: Float[np.ndarray, " h"]
    rms_angle: Float[np.ndarray, " h"]
    sigma: Float[np.ndarray, " h"]
    weight: Float[np.ndarray, " h"]
    cameras: Int[np.ndarray, " h"]
    tracklet: Int[np.ndarray, "h cam"]
    supporting_tracklet: Int[np.ndarray, "h cam"]
    score: Float[np.ndarray, " h"]


class Selection(NamedTuple):
    """The outcome of the filters.

    Attributes:
        fate: (H,) `Fate` of each hypothesis.
        tau_sigma: uncertainty threshold of the first pass, or None.
        tau_g: ground threshold of the first pass, or None.
        tau_sigma_recovery: uncertainty threshold of the recovery, or None.
        tau_g_recovery: ground threshold of the recovery, or None.
    """

    fate: Int[np.ndarray, " h"]
    tau_sigma: float | None
    tau_g: float | None
    tau_sigma_recovery: float | None
    tau_g_recovery: float | None

    @property
    def accepted(self) -> Bool[np.ndarray, " h"]:
        """(H,) true for hypotheses that became positions."""
        return (self.fate == Fate.ACCEPTED) | (self.fate == Fate.RECOVERED)


def select_positions(
    hypotheses: Hypotheses, settings: SelectionSettings, *, sigma_theta: float
) -> Selection:
    """Decide the fate of every hypothesis.

    Args:
        hypotheses: their measurements, lengths as shares of E.
        settings: which filters run, and their radii.
        sigma_theta: angular noise in radians.

    Returns:
        Fates and thresholds.

    Source:
        Sec. "Selecting pedestrian positions".
    """
    h = hypotheses
    fate = np.full(len(h.frame_index), Fate.ACCEPTED, np.int64)
    consistent = h.rms_angle <= settings.rms_factor * sigma_theta
    fate[~consistent] = Fate.RMS_GATE
    keep, tau_sigma, tau_g = _gate(h, consistent, fate, settings)
    # A match counts wherever its two tracklets support a hypothesis together, in their own group or
    # another, accepted or not.
    matched = temporally_consistent(
        np.concatenate([h.frame_index, h.frame_index]),
        np.concatenate([h.tracklet, h.supporting_tracklet]),
        minimum_frames=settings.temporal_frames,
    )[: len(fate)]
    lasting = keep & matched
    fate[keep & ~matched] = Fate.TEMPORAL_FILTER
    tie_break = h.score if settings.use_score else np.zeros_like(h.score)
    priority = np.stack([h.weight, tie_break], axis=-1)
    radius = settings.suppression_radius
    accepted = suppress_by_frame(h.frame_index, h.ground_xy, priority, lasting, radius)
    fate[lasting & ~accepted] = Fate.SUPPRESSED
    tau_sigma_recovery = tau_g_recovery = None
    if settings.recover and accepted.any():
        free = outside_by_frame(h.frame_index, h.ground_xy, accepted, consistent, radius)
        rejected = fate.copy()
        again, tau_sigma_recovery, tau_g_recovery = _gate(h, free, rejected, settings)
        again = again & matched & (h.cameras >= settings.recovery_cameras)
        again = suppress_by_frame(h.frame_index, h.ground_xy, priority, again, radius)
        fate[again] = Fate.RECOVERED
    return Selection(fate, tau_sigma, tau_g, tau_sigma_recovery, tau_g_recovery)


_select = jax.jit(select, static_argnames=("gates", "fixed_quantile"))


def _gate(
    h: Hypotheses,
    candidate: Bool[np.ndarray, " h"],
    fate: Int[np.ndarray, " h"],
    settings: SelectionSettings,
) -> tuple[Bool[np.ndarray, " h"], float | None, float | None]:
    """Run the adaptive gates on the candidates, and record the fate of those they remove."""
    count = len(candidate)
    padding = (0, padded_length(count, SAMPLE_BLOCK) - count)
    gates = _select(
        np.pad(h.sigma, padding),
        np.pad(h.ground_distance, padding),
        np.pad(h.weight, padding),
        np.pad(candidate, padding),
        gates=settings.gates,
        fixed_quantile=settings.fixed_quantile,
    )
    fate[np.asarray(gates.uncertain)[:count]] = Fate.UNCERTAINTY_FILTER
    fate[np.asarray(gates.off_ground)[:count]] = Fate.GROUND_FILTER
    fate[np.asarray(gates.unsupported)[:count]] = Fate.SUPPORT_FILTER
    tau_sigma, tau_g = float(gates.tau_sigma), float(gates.tau_g)
    return (
        np.asarray(gates.keep)[:count],
        tau_sigma if np.isfinite(tau_sigma) else None,
        tau_g if np.isfinite(tau_g) else None,
    )


def suppress_by_frame(
    frame_index: Int[np.ndarray, " h"],
    ground_xy: Float[np.ndarray, "h 2"],
    priority: Float[np.ndarray, "h rank"],
    candidate: Bool[np.ndarray, " h"],
    radius: float,
) -> Bool[np.ndarray, " h"]:
    """Apply non-maximum suppression in every frame.

    Args:
        frame_index: (H,) frame of each position.
        ground_xy: (H, 2) position on the ground.
        priority: (H, k) rank; later columns break ties.
        candidate: (H,) which positions take part.
        radius: suppression radius in the unit of the positions.

    Returns:
        (H,) bool, which positions are kept.
    """
    rivals = candidate.copy()
    rows = np.flatnonzero(candidate)
    rivals[rows] = _has_neighbor(frame_index[rows], ground_xy[rows], radius)
    keep = candidate & ~rivals
    for grid in _frame_grids(frame_index, rivals):
        kept = _suppress_frames(ground_xy[grid], priority[grid], radius, grid >= 0)
        keep[grid[np.asarray(kept)]] = True
    return keep


def _has_neighbor(
    frame_index: Int[np.ndarray, " n"], ground_xy: Float[np.ndarray, "n 2"], radius: float
) -> Bool[np.ndarray, " n"]:
    """Mark positions (N,) with a neighbor within the radius in their frame, and maybe some more."""
    has_neighbor = np.ones(len(ground_xy), bool)
    finite = np.flatnonzero(np.isfinite(ground_xy).all(1))
    if len(finite) == 0:
        return has_neighbor
    xy = ground_xy[finite].astype(np.float64)
    # Positions may be rounded to single precision later.
    reach = 1.001 * float(radius) + 1e-6 * float(np.abs(xy).max()) + np.finfo(float).tiny
    apart = np.column_stack([xy / reach, 4.0 * frame_index[finite]])
    nearest, _ = KDTree(apart).query(apart, 2, distance_upper_bound=1.0)
    has_neighbor[finite] = np.isfinite(nearest[:, 1])
    return has_neighbor


def outside_by_frame(
    frame_index: Int[np.ndarray, " h"],
    ground_xy: Float[np.ndarray, "h 2"],
    accepted: Bool[np.ndarray, " h"],
    candidate: Bool[np.ndarray, " h"],
    radius: float,
) -> Bool[np.ndarray, " h"]:
    """Mark candidates farther than the radius from all accepted positions of their frame, (H,)."""
    free = np.zeros(len(candidate), bool)
    for grid in _frame_grids(frame_index, candidate | accepted):
        present = grid >= 0
        outcome = _outside_frames(
            ground_xy[grid], accepted[grid] & present, radius, candidate[grid] & present
        )
        free[grid[np.asarray(outcome)]] = True
    return free


def _frame_grids(
    frame_index: Int[np.ndarray, " h"], where: Bool[np.ndarray, " h"]
) -> list[Int[np.ndarray, "f place"]]:
    """Rows of the chosen hypotheses, one line per frame, -1 for padding, in blocks of lines."""
    rows = np.flatnonzero(where)
    if len(rows) == 0:
        return []
    rows = rows[np.argsort(frame_index[rows], kind="stable")]
    frames, start, count = np.unique(frame_index[rows], return_index=True, return_counts=True)
    places = padded_length(int(count.max()), PLACES_BLOCK, factor=2)
    # Sequences compile the same functions, however few of their frames hold chosen hypotheses.
    is_sequence = frame_index.min() < frame_index.max()
    block = min(FRAME_BLOCK, max(1, PAIRS_BLOCK // places**2)) if is_sequence else 1
    lines = -(-len(frames) // block) * block
    grid = np.full((lines, places), -1)
    line = np.repeat(np.arange(len(frames)), count)
    grid[line, np.arange(len(rows)) - start[line]] = rows
    return list(grid.reshape(-1, block, places))


_suppress_frames = jax.jit(jax.vmap(suppress, (0, 0, None, 0)))
_outside_frames = jax.jit(jax.vmap(outside, (0, 0, None, 0)))
