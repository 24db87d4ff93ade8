"""Align the gauges (frames and scales) of the instants.

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
    """Rotations and centers of one or N instants, and which are known."""

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


def finite(center: Float[np.ndarray, "cam 3"]) -> Bool[np.ndarray, " cam"]:
    """Mark the finite centers, (C,)."""
    return np.asarray(np.isfinite(center).all(axis=-1))


def align(poses: Poses, target: Poses) -> Gauges:
    """Fit the similarity from each instant to one rig by medians over cameras.

    Instants that share fewer than two cameras with the rig get scale NaN.
    """
    shared = poses.known & target.known
    target_R = np.where(target.known[:, None, None], target.R, np.eye(3))
    turns = np.swapaxes(target_R, -1, -2)[None] @ poses.R
    rotation = median_rotation(np.swapaxes(turns, 0, 1), shared.T)
    first, second = np.triu_indices(poses.known.shape[1], 1)
    both = shared[:, first] & shared[:, second]
    distance = np.linalg.norm(poses.center[:, first] - poses.center[:, second], axis=-1)
    target_distance = np.linalg.norm(target.center[first] - target.center[second], axis=-1)
    usable = both & (distance > 0) & (target_distance > 0)[None]
    ratio = np.where(
        usable, np.log(np.where(usable, target_distance, 1.0) / np.where(usable, distance, 1.0)), 0
    )
    scale = np.exp(median_of_present(ratio, usable))
    turned = scale[:, None, None] * np.einsum("nij,ncj->nci", rotation, poses.center)
    offset = target.center[None] - turned
    translation = geometric_median(
        np.swapaxes(np.where(shared[..., None], offset, 0.0), 0, 1), shared.T
    )
    lost = ~usable.any(axis=1)
    return Gauges(
        np.where(lost, np.nan, scale),
        np.where(lost[:, None, None], np.eye(3), rotation),
        np.where(lost[:, None], 0.0, translation),
    )


def median_of_present(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Medians of the present values along the last axis, NaN if there are none."""
    any_present = np.asarray(present.any(axis=-1, keepdims=True))
    median = np.nanmedian(np.where(present | ~any_present, values, np.nan), axis=-1)
    return np.where(any_present[..., 0], median, np.nan)


def _disagreement(aligned: Poses, R: np.ndarray, center: np.ndarray) -> np.ndarray:
    """(N,) median over cameras of angle + distance / extent; inf if no camera is known."""
    averaged = finite(center)
    known, centers = aligned.known & averaged, center[averaged]
    extent = 2 * np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=-1))
    away = np.linalg.norm(np.where(known[..., None], aligned.center - center, 0.0), axis=-1)
    turned = angle(np.where(known[..., None, None], aligned.R, np.eye(3)), np.nan_to_num(R)[None])
    median = median_of_present(turned + away / extent, known)
    return np.where(np.isfinite(median), median, np.inf)


def central_instant(poses: Poses) -> Poses:
    """Find the instant that agrees best with the others."""
    cost = np.full(len(poses.R), np.inf)
    for instant in np.flatnonzero(poses.known.sum(axis=1) >= 2):
        target = Poses(poses.R[instant], poses.center[instant], poses.known[instant])
        center = np.where(target.known[:, None], target.center, np.nan)
        aligned = align(poses, target).poses(poses)
        # The lower median: two instants are equally good.
        apart = np.sort(_disagreement(aligned, target.R, center))
        # Few shared cameras agree easily, so missing cameras count as disagreement.
        cost[instant] = apart[len(apart) // 2] + (~target.known).mean()
    best = int(np.argmin(cost))
    return Poses(poses.R[best], poses.center[best], poses.known[best])


def agreeing(aligned: Poses, R: np.ndarray, center: np.ndarray) -> Bool[np.ndarray, " n"]:
    """Mark the instants that do not disagree unusually much with the rig, (N,)."""
    apart = _disagreement(aligned, R, center)
    usual = np.median(apart[np.isfinite(apart)])
    return apart <= max(OUTLIER_FACTOR * MEDIAN_TO_DEVIATION * usual, AGREEMENT)


def average_poses(aligned: Poses, used: Bool[np.ndarray, "n cam"]) -> tuple[np.ndarray, np.ndarray]:
    """Average to (C, 3, 3) rotations and (C, 3) centers, NaN for cameras without known poses."""
    center = np.where(used[..., None], aligned.center, 0.0)
    return median_rotation(aligned.R, used), geometric_median(center, used)


def usual_scale(gauges: Gauges, inliers: Bool[np.ndarray, " n"]) -> Gauges:
    """Rescale the gauges so that the median scale of the inlier instants is kept."""
    factor = np.exp(-np.median(np.log(gauges.scale[inliers])))
    return Gauges(factor * gauges.scale, gauges.rotation, factor * gauges.translation)
