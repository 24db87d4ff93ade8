"""Averaging of reconstructions of several instants, each in its own gauge, into one static rig."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from catfree.calibration.reconstructions._gauges import (
    Gauges,
    Poses,
    agreeing,
    align,
    average_poses,
    central_instant,
    median_of_present,
    usual_scale,
)
from catfree.calibration.reconstructions._robust_mean import angle
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.geometry._arrays import MEDIAN_TO_DEVIATION, ArrayInput
from catfree.types import Rig
from catfree.types._sampling import evenly_spread
from catfree.types.results._reconstruction import Reconstruction

REALIGNMENTS = 5  # rounds of alignment and averaging; two or three suffice to converge
MAXIMUM_POINTS = 200_000  # points kept of the merged cloud, evenly sampled
ROUNDING = 1e-6  # of single-precision centers, relative to their distance from the origin


@dataclass(frozen=True)
class Spread:
    """Disagreement of the instants about each camera, as robust standard deviations.

    Attributes:
        rotation: (C,) radians.
        center: (C,) scene units.
        log_focal: (C,) of the natural logarithm of the focal length.
        instants: (C,) number of instants averaged per camera.
    """

    rotation: Float[np.ndarray, " cam"]
    center: Float[np.ndarray, " cam"]
    log_focal: Float[np.ndarray, " cam"]
    instants: np.ndarray


@dataclass(frozen=True)
class Aggregate:
    """A static rig and the scene points of the inlier instants in its frame.

    Attributes:
        rig: the cameras; those without inlier instants are not registered and NaN.
        points: (P, 3) scene points of the inlier instants.
        confidence: (P,) of each point, relative to the median of its instant.
        spread: disagreement of the instants, per camera.
        inliers: (N,) whether the instant agrees with the rig.
        metric: whether scene units are meters.
    """

    rig: Rig
    points: Float[np.ndarray, "p 3"]
    confidence: Float[np.ndarray, " p"]
    spread: Spread
    inliers: Bool[np.ndarray, " n"]
    metric: bool


def aggregate(reconstructions: Sequence[Reconstruction], image_size: ArrayInput) -> Aggregate:
    """Average the cameras of several instants, each in its own frame and scale.

    The instants are aligned to the one that agrees best with the others, then to their average.
    All averages are medians (of angles, distances and log focal lengths), so up to a third of the
    instants, and single cameras in the others, may be wrong.

    Args:
        reconstructions: one per instant, with the same cameras in the same order.
        image_size: (2,) or (C, 2) width and height in pixels.

    Returns:
        The rig in the frame of the central instant and the median scale of the instants, and the
        merged points.

    Raises:
        InvalidInputError: if the reconstructions have different numbers of cameras.
        InsufficientDataError: if no reconstruction has two registered cameras at different places.
    """
    if not reconstructions:
        raise InsufficientDataError("There are no reconstructions to aggregate; pass at least one.")
    counts = [len(reconstruction.t) for reconstruction in reconstructions]
    if len(set(counts)) > 1:
        at = next(i for i, count in enumerate(counts) if count != counts[0])
        raise InvalidInputError(
            f"Reconstruction {at} has {counts[at]} cameras, but reconstruction 0 has {counts[0]}."
        )
    poses = _poses(reconstructions)
    if not _have_extent(poses).any():
        raise InsufficientDataError(
            f"None of the {len(reconstructions)} reconstructions registers two cameras at "
            "different places; a rig needs at least two."
        )
    gauges = align(poses, central_instant(poses))
    inliers = np.isfinite(gauges.scale)
    for _ in range(REALIGNMENTS):
        aligned = gauges.poses(poses)
        inliers = agreeing(aligned, average_poses(aligned, aligned.known))
        gauges = align(poses, average_poses(aligned, aligned.known & inliers[:, None]))
    gauges = usual_scale(gauges, inliers)
    aligned = gauges.poses(poses)
    used = aligned.known & inliers[:, None]
    average = average_poses(aligned, used)
    K = np.stack([reconstruction.K for reconstruction in reconstructions]).astype(np.float64)
    average_K = _average_intrinsics(K, used)
    t = -np.einsum("cij,cj->ci", average.R, average.center)
    rig = Rig(average_K, average.R, t, image_size, registered=average.known)
    points, confidence = _merged_points(reconstructions, gauges, inliers)
    return Aggregate(
        rig,
        points,
        confidence,
        _spread(aligned, K, used, average, average_K),
        inliers,
        all(reconstruction.scale_is_metric for reconstruction in reconstructions),
    )


def _poses(reconstructions: Sequence[Reconstruction]) -> Poses:
    R = np.stack([reconstruction.R for reconstruction in reconstructions]).astype(np.float64)
    t = np.stack([reconstruction.t for reconstruction in reconstructions]).astype(np.float64)
    known = np.stack([reconstruction.registered for reconstruction in reconstructions])
    return Poses(R, -np.einsum("ncji,ncj->nci", R, t), known)


def _have_extent(poses: Poses) -> Bool[np.ndarray, " n"]:
    """Mark the instants in which two known cameras are at different places."""
    first = poses.center[np.arange(len(poses.center)), poses.known.argmax(axis=1)]
    away = np.linalg.norm(poses.center - first[:, None], axis=-1)
    apart = away > ROUNDING * np.linalg.norm(poses.center, axis=-1)
    return np.asarray((poses.known & apart).any(axis=1))


def _average_intrinsics(K: np.ndarray, used: np.ndarray) -> np.ndarray:
    """(C, 3, 3) medians of the intrinsics; focal lengths are averaged as logarithms."""
    average = np.full(K.shape[1:], np.nan)
    for row, column in ((0, 0), (1, 1)):
        average[:, row, column] = np.exp(median_of_present(np.log(K[:, :, row, column]).T, used.T))
    for row, column in ((0, 1), (0, 2), (1, 2)):
        average[:, row, column] = median_of_present(K[:, :, row, column].T, used.T)
    average[:, [1, 2, 2], [0, 0, 1]] = 0.0
    average[:, 2, 2] = 1.0
    return average


def _spread(
    aligned: Poses, K: np.ndarray, used: np.ndarray, average: Poses, average_K: np.ndarray
) -> Spread:
    turned = angle(aligned.R, average.R[None])
    away = np.linalg.norm(aligned.center - average.center, axis=-1)
    focal = np.abs(np.log(np.where(used, K[:, :, 0, 0] / average_K[:, 0, 0], 1.0)))
    rotation, center, log_focal = (
        MEDIAN_TO_DEVIATION * median_of_present(off.T, used.T) for off in (turned, away, focal)
    )
    return Spread(rotation, center, log_focal, used.sum(axis=0))


def _merged_points(
    reconstructions: Sequence[Reconstruction], gauges: Gauges, inliers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Merge the points of the inlier instants in the common frame, with relative confidences."""
    points, confidence = [np.zeros((0, 3))], [np.zeros(0)]
    for instant in np.flatnonzero(inliers).tolist():
        reconstruction = reconstructions[instant]
        if len(reconstruction.points) == 0:
            continue
        turned = reconstruction.points.astype(np.float64) @ gauges.rotation[instant].T
        points.append(gauges.scale[instant] * turned + gauges.translation[instant])
        typical = float(np.median(reconstruction.confidence))
        confidence.append(reconstruction.confidence / (typical if typical > 0 else 1.0))
    merged = evenly_spread(np.concatenate(points), MAXIMUM_POINTS)
    merged_confidence = np.concatenate(confidence).astype(np.float64)
    return merged, evenly_spread(merged_confidence, MAXIMUM_POINTS)
