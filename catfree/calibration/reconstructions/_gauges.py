"""Alignment of the gauges (frames and scales) of the instants.

A reconstruction determines its cameras up to a similarity, its gauge. Instants can be compared,
averaged and rejected only in a common gauge, so this module contains alignment, averages and
disagreement, all based on medians over cameras or instants.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from catfree.calibration.reconstructions._robust_mean import (
    angle,
    geometric_median,
    median_rotation,
)
from catfree.geometry._arrays import MEDIAN_TO_DEVIATION

OUTLIER_FACTOR = 3.0  # robust standard deviations of the instants' disagreement
# Instants that agree this well (radians, or fractions of the rig's extent) are never outliers.
AGREEMENT = 0.01


@dataclass(frozen=True)
class Poses:
    """Rotations and centers of a rig or of N instants, and which cameras are known."""

    R: Float[np.ndarray, "*n cam 3 3"]
    center: Float[np.ndarray, "*n cam 3"]
    known: Bool[np.ndarray, "*n cam"]


@dataclass(frozen=True)
class Gauges:
    """Similarities, one per instant: `x -> scale rotation x + translation`."""

    scale: Float[np.ndarray, " n"]
    rotation: Float[np.ndarray, "n 3 3"]
    translation: Float[np.ndarray, "n 3"]

    def poses(self, poses: Poses) -> Poses:
        """Transform the poses of N instants from their own frames to the common frame."""
        R = poses.R @ np.swapaxes(self.rotation, -1, -2)[:, None]
        turned = np.einsum("nij,ncj->nci", self.rotation, poses.center)
        center = self.scale[:, None, None] * turned + self.translation[:, None]
        return Poses(R, center, poses.known & np.isfinite(self.scale)[:, None])


def align(poses: Poses, target: Poses) -> Gauges:
    """Fit the similarity from each instant to one rig by medians over cameras.

    Instants that share fewer than two cameras with the rig get scale NaN.
    """
    shared = poses.known & target.known
    turns = np.swapaxes(target.R, -1, -2)[None] @ poses.R
    rotation = median_rotation(np.swapaxes(turns, 0, 1), shared.T)
    first, second = np.triu_indices(poses.known.shape[1], 1)
    both = shared[:, first] & shared[:, second]
    distance = np.linalg.norm(poses.center[:, first] - poses.center[:, second], axis=-1)
    target_distance = np.linalg.norm(target.center[first] - target.center[second], axis=-1)
    usable = both & (distance > 0) & (target_distance > 0)[None]
    ratio = np.log(np.where(usable, target_distance, 1.0) / np.where(usable, distance, 1.0))
    scale = np.exp(median_of_present(ratio, usable))
    turned = scale[:, None, None] * np.einsum("nij,ncj->nci", rotation, poses.center)
    shared &= np.isfinite(scale)[:, None]
    translation = geometric_median(np.swapaxes(target.center[None] - turned, 0, 1), shared.T)
    return Gauges(scale, rotation, translation)


def median_of_present(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Medians of the present values along the last axis, NaN if there are none."""
    any_present = np.asarray(present.any(axis=-1, keepdims=True))
    filled = np.where(present, values, np.where(any_present, np.nan, 0.0))
    return np.where(any_present[..., 0], np.nanmedian(filled, axis=-1), np.nan)


def _disagreement(aligned: Poses, rig: Poses) -> np.ndarray:
    """(N,) median over cameras of angle + distance / extent; inf if no camera is known."""
    known, centers = aligned.known & rig.known, rig.center[rig.known]
    extent = 2 * np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=-1))
    away = np.linalg.norm(aligned.center - rig.center, axis=-1)
    median = median_of_present(angle(aligned.R, rig.R[None]) + away / extent, known)
    return np.where(np.isfinite(median), median, np.inf)


def central_instant(poses: Poses) -> Poses:
    """Find the instant that agrees best with the others."""
    cost = np.full(len(poses.R), np.inf)
    for instant in np.flatnonzero(poses.known.sum(axis=1) >= 2):
        target = Poses(poses.R[instant], poses.center[instant], poses.known[instant])
        # The lower median, so that two instants are equally good.
        apart = np.sort(_disagreement(align(poses, target).poses(poses), target))
        # Few shared cameras agree easily, so missing cameras count as disagreement.
        cost[instant] = apart[len(apart) // 2] + (~target.known).mean()
    best = int(np.argmin(cost))
    return Poses(poses.R[best], poses.center[best], poses.known[best])


def agreeing(aligned: Poses, rig: Poses) -> Bool[np.ndarray, " n"]:
    """Mark the instants that agree with the rig as well as is usual, (N,)."""
    apart = _disagreement(aligned, rig)
    usual = np.median(apart[np.isfinite(apart)])
    return apart <= max(OUTLIER_FACTOR * MEDIAN_TO_DEVIATION * usual, AGREEMENT)


def average_poses(aligned: Poses, used: Bool[np.ndarray, "n cam"]) -> Poses:
    """Average the used poses of each camera; cameras without any become NaN and unknown."""
    R, center = median_rotation(aligned.R, used), geometric_median(aligned.center, used)
    return Poses(R, center, np.asarray(used.any(axis=0)))


def usual_scale(gauges: Gauges, inliers: Bool[np.ndarray, " n"]) -> Gauges:
    """Rescale the gauges so that the median scale of the inlier instants is kept."""
    factor = np.exp(-np.median(np.log(gauges.scale[inliers])))
    return Gauges(factor * gauges.scale, gauges.rotation, factor * gauges.translation)
