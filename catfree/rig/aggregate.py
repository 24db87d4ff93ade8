"""One static rig from reconstructions of several instants, each in a frame and scale of its own."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from catfree.adapters.protocols import Reconstruction, Reconstructor
from catfree.adapters.video import SynchronizedVideos
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.rig.ground import find_ground
from catfree.rig.robust_mean import angle, geometric_median, median_rotation
from catfree.types import Detections, Rig, Scene

Progress = Callable[[str, int, int], None]

INSTANTS = 12  # reconstructed from a video: four of them may be garbage
REALIGNMENTS = 5  # aligning to the average and averaging again; it settles after two or three
OUTLIER_FACTOR = 3.0  # in robust standard deviations of the instants' disagreement
# Instants that agree this well (radians, or shares of the rig's extent) are never outliers.
AGREEMENT = 0.01
MEDIAN_TO_DEVIATION = 1.4826  # of absolute deviations of a normal variable
MAXIMUM_POINTS = 200_000  # kept of the merged cloud, evenly


@dataclass(frozen=True)
class Spread:
    """How much the instants disagree about each camera: robust standard deviations.

    Attributes:
        rotation: (C,) radians.
        center: (C,) scene units.
        log_focal: (C,) of the logarithm of the focal length.
        instants: (C,) number of instants that each camera's average rests on.
    """

    rotation: Float[np.ndarray, " cam"]
    center: Float[np.ndarray, " cam"]
    log_focal: Float[np.ndarray, " cam"]
    instants: np.ndarray


@dataclass(frozen=True)
class Aggregate:
    """A static rig and the scene points of all instants in its frame.

    Attributes:
        rig: the cameras; those that no inlier saw are not registered and NaN.
        points: (P, 3) scene points of the inlier instants.
        confidence: (P,) of each point; 1 is the median of its instant.
        spread: disagreement of the instants, a camera.
        inliers: (N,) which instants agree with the rig.
        metric: whether scene units are metres.
    """

    rig: Rig
    points: Float[np.ndarray, "p 3"]
    confidence: Float[np.ndarray, " p"]
    spread: Spread
    inliers: Bool[np.ndarray, " n"]
    metric: bool


@dataclass(frozen=True)
class _Poses:
    """Rotations and centres of one or N instants in some frame, and which are known."""

    R: Float[np.ndarray, "*n cam 3 3"]
    center: Float[np.ndarray, "*n cam 3"]
    known: Bool[np.ndarray, "*n cam"]


@dataclass(frozen=True)
class _Gauges:
    """Similarities, one an instant: `x -> scale rotation x + translation`."""

    scale: Float[np.ndarray, " n"]
    rotation: Float[np.ndarray, "n 3 3"]
    translation: Float[np.ndarray, "n 3"]

    def poses(self, poses: _Poses) -> _Poses:
        R = poses.R @ np.swapaxes(self.rotation, -1, -2)[:, None]
        turned = np.einsum("nij,ncj->nci", self.rotation, poses.center)
        center = self.scale[:, None, None] * turned + self.translation[:, None]
        return _Poses(R, center, poses.known & np.isfinite(self.scale)[:, None])


def aggregate(reconstructions: Sequence[Reconstruction], image_size: Any) -> Aggregate:
    """Average the cameras of several instants, each in its own frame and scale.

    The instants are aligned to the one that agrees best with the others, then to their average.
    All averages are medians (of angles, of distances, of log focal lengths), so that up to a third
    of the instants, and single cameras of the others, may be garbage.

    Args:
        reconstructions: one an instant, the same cameras in the same order.
        image_size: (2,) or (C, 2) width and height in pixels.

    Returns:
        The rig in the frame of the central instant and in the usual scale of the instants, and the
        merged points.

    Raises:
        InvalidInputError: if the reconstructions have different numbers of cameras.
        InsufficientDataError: if there is none, or none in which two cameras are registered.
    """
    if not reconstructions:
        raise InsufficientDataError("There is no reconstruction to aggregate: pass at least one.")
    counts = [len(reconstruction.t) for reconstruction in reconstructions]
    if len(set(counts)) > 1:
        at = next(i for i, count in enumerate(counts) if count != counts[0])
        raise InvalidInputError(
            f"Reconstruction {at} has {counts[at]} cameras, but reconstruction 0 has {counts[0]}."
        )
    poses = _poses(reconstructions)
    if (poses.known.sum(axis=1) < 2).all():
        raise InsufficientDataError(
            f"In none of the {len(reconstructions)} reconstructions two cameras are registered."
        )
    gauges = _align(poses, _central_instant(poses))
    inliers = np.isfinite(gauges.scale)
    for _ in range(REALIGNMENTS):
        aligned = gauges.poses(poses)
        inliers = _agreeing(aligned, *_average(aligned, aligned.known))
        R, center = _average(aligned, aligned.known & inliers[:, None])
        gauges = _align(poses, _Poses(R, center, _finite(center)))
    gauges = _usual_scale(gauges, inliers)
    aligned = gauges.poses(poses)
    used = aligned.known & inliers[:, None]
    R, center = _average(aligned, used)
    K = np.stack([reconstruction.K for reconstruction in reconstructions]).astype(np.float64)
    average_K = _average_intrinsics(K, used)
    registered = used.any(axis=0)
    t = -np.einsum("cij,cj->ci", R, center)
    rig = Rig(average_K, R, t, image_size, registered=registered)
    points, confidence = _merged_points(reconstructions, gauges, inliers)
    return Aggregate(
        rig,
        points,
        confidence,
        _spread(aligned, K, used, R, center, average_K),
        inliers,
        all(reconstruction.scale_is_metric for reconstruction in reconstructions),
    )


def scene_from_videos(
    videos: SynchronizedVideos,
    reconstructor: Reconstructor,
    detections: Detections | None = None,
    progress: Progress | None = None,
    *,
    instants: int = INSTANTS,
    seed: int = 0,
) -> Scene:
    """Cameras and ground from some instants of videos, spread evenly over their length.

    Args:
        videos: the cameras' videos.
        reconstructor: finds the cameras of one instant.
        detections: people, who tell the ground from a wall; None to go by the cameras alone.
        progress: called as `progress("reconstruction", done, instants)`.
        instants: how many instants are reconstructed.
        seed: of the search for the ground.

    Returns:
        The scene, in metres if the reconstructor's units are.

    Raises:
        InsufficientDataError: if no instant shows two cameras that can be placed.
        GroundRejectedError: if no plane of the scene can be the ground.
    """
    report = progress or (lambda stage, done, total: None)
    count = min(instants, videos.frame_count)
    # The middles of equal parts: the first and the last instants are often not usable.
    chosen = ((np.arange(count) + 0.5) * videos.frame_count / count).astype(int)
    reconstructions = []
    for done, position in enumerate(chosen):
        report("reconstruction", done, count)
        _, images = next(iter(videos.instants_from(int(position))))
        reconstructions.append(reconstructor(images))
    report("reconstruction", count, count)
    found = aggregate(reconstructions, videos.image_size)
    ground = find_ground(
        found.points, found.rig, detections, confidence=found.confidence, seed=seed
    )
    return Scene.from_rig(found.rig, ground.plane, metric=found.metric)


def _finite(center: Float[np.ndarray, "cam 3"]) -> Bool[np.ndarray, " cam"]:
    return np.asarray(np.isfinite(center).all(axis=-1))


def _poses(reconstructions: Sequence[Reconstruction]) -> _Poses:
    R = np.stack([reconstruction.R for reconstruction in reconstructions]).astype(np.float64)
    t = np.stack([reconstruction.t for reconstruction in reconstructions]).astype(np.float64)
    known = np.stack([reconstruction.registered for reconstruction in reconstructions])
    return _Poses(R, -np.einsum("ncji,ncj->nci", R, t), known)


def _align(poses: _Poses, target: _Poses) -> _Gauges:
    """The similarity from each instant to one rig, (cam, ...) arrays, by medians over cameras.

    An instant that shares fewer than two cameras with the rig gets NaN.
    """
    shared = poses.known & target.known
    target_R = np.where(target.known[:, None, None], target.R, np.eye(3))
    turns = np.swapaxes(target_R, -1, -2)[None] @ poses.R
    rotation = median_rotation(np.swapaxes(turns, 0, 1), shared.T)
    first, second = np.triu_indices(poses.known.shape[1], 1)
    both = shared[:, first] & shared[:, second]
    own = np.linalg.norm(poses.center[:, first] - poses.center[:, second], axis=-1)
    other = np.linalg.norm(target.center[first] - target.center[second], axis=-1)
    usable = both & (own > 0) & (other > 0)[None]
    ratio = np.where(usable, np.log(np.where(usable, other, 1.0) / np.where(usable, own, 1.0)), 0)
    scale = np.exp(_median(ratio, usable))
    turned = scale[:, None, None] * np.einsum("nij,ncj->nci", rotation, poses.center)
    offset = target.center[None] - turned
    translation = geometric_median(
        np.swapaxes(np.where(shared[..., None], offset, 0.0), 0, 1), shared.T
    )
    lost = ~usable.any(axis=1)
    return _Gauges(
        np.where(lost, np.nan, scale),
        np.where(lost[:, None, None], np.eye(3), rotation),
        np.where(lost[:, None], 0.0, translation),
    )


def _median(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Medians along the last axis of what is present, NaN where nothing is."""
    some = np.asarray(present.any(axis=-1, keepdims=True))
    median = np.nanmedian(np.where(present | ~some, values, np.nan), axis=-1)
    return np.where(some[..., 0], median, np.nan)


def _disagreement(aligned: _Poses, R: np.ndarray, center: np.ndarray) -> np.ndarray:
    """(N,) median over the cameras of angle + distance / extent; inf where no camera is known."""
    averaged = _finite(center)
    known, centers = aligned.known & averaged, center[averaged]
    extent = 2 * np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=-1))
    away = np.linalg.norm(np.where(known[..., None], aligned.center - center, 0.0), axis=-1)
    turned = angle(np.where(known[..., None, None], aligned.R, np.eye(3)), np.nan_to_num(R)[None])
    median = _median(turned + away / extent, known)
    return np.where(np.isfinite(median), median, np.inf)


def _central_instant(poses: _Poses) -> _Poses:
    """The instant whose cameras the others agree with best."""
    cost = np.full(len(poses.R), np.inf)
    for instant in np.flatnonzero(poses.known.sum(axis=1) >= 2):
        target = _Poses(poses.R[instant], poses.center[instant], poses.known[instant])
        center = np.where(target.known[:, None], target.center, np.nan)
        aligned = _align(poses, target).poses(poses)
        # The lower median: with two instants either is as good as the other.
        apart = np.sort(_disagreement(aligned, target.R, center))
        # Few shared cameras agree easily: what is not shared counts as a disagreement.
        cost[instant] = apart[len(apart) // 2] + (~target.known).mean()
    best = int(np.argmin(cost))
    return _Poses(poses.R[best], poses.center[best], poses.known[best])


def _agreeing(aligned: _Poses, R: np.ndarray, center: np.ndarray) -> Bool[np.ndarray, " n"]:
    apart = _disagreement(aligned, R, center)
    usual = np.median(apart[np.isfinite(apart)])
    return apart <= max(OUTLIER_FACTOR * MEDIAN_TO_DEVIATION * usual, AGREEMENT)


def _average(aligned: _Poses, used: Bool[np.ndarray, "n cam"]) -> tuple[np.ndarray, np.ndarray]:
    """(C, 3, 3) rotations and (C, 3) centres, NaN for cameras that nobody knows."""
    center = np.where(used[..., None], aligned.center, 0.0)
    return median_rotation(aligned.R, used), geometric_median(center, used)


def _usual_scale(gauges: _Gauges, inliers: Bool[np.ndarray, " n"]) -> _Gauges:
    """The same gauges, scaled so that the instants' own scales are kept on average."""
    factor = np.exp(-np.median(np.log(gauges.scale[inliers])))
    return _Gauges(factor * gauges.scale, gauges.rotation, factor * gauges.translation)


def _average_intrinsics(K: np.ndarray, used: np.ndarray) -> np.ndarray:
    """(C, 3, 3) medians; of the logarithm where a focal length is meant."""
    average = np.full(K.shape[1:], np.nan)
    for row, column in ((0, 0), (1, 1)):
        average[:, row, column] = np.exp(_median(np.log(K[:, :, row, column]).T, used.T))
    for row, column in ((0, 1), (0, 2), (1, 2)):
        average[:, row, column] = _median(K[:, :, row, column].T, used.T)
    average[:, [1, 2, 2], [0, 0, 1]] = 0.0
    average[:, 2, 2] = 1.0
    return average


def _spread(
    aligned: _Poses,
    K: np.ndarray,
    used: np.ndarray,
    R: np.ndarray,
    center: np.ndarray,
    average_K: np.ndarray,
) -> Spread:
    turned = angle(aligned.R, np.where(np.isfinite(R), R, np.eye(3))[None])
    away = np.linalg.norm(np.where(used[..., None], aligned.center - center, 0.0), axis=-1)
    focal = np.where(used, np.log(K[:, :, 0, 0] / average_K[:, 0, 0]), 0.0)
    return Spread(
        MEDIAN_TO_DEVIATION * _median(turned.T, used.T),
        MEDIAN_TO_DEVIATION * _median(away.T, used.T),
        MEDIAN_TO_DEVIATION * _median(np.abs(focal).T, used.T),
        used.sum(axis=0),
    )


def _merged_points(
    reconstructions: Sequence[Reconstruction], gauges: _Gauges, inliers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points of the inlier instants in the common frame, and their relative confidences."""
    points, confidence = [np.zeros((0, 3))], [np.zeros(0)]
    for instant in np.flatnonzero(inliers).tolist():
        reconstruction = reconstructions[instant]
        if len(reconstruction.points) == 0:
            continue
        turned = reconstruction.points.astype(np.float64) @ gauges.rotation[instant].T
        points.append(gauges.scale[instant] * turned + gauges.translation[instant])
        typical = float(np.median(reconstruction.confidence))
        confidence.append(reconstruction.confidence / (typical if typical > 0 else 1.0))
    merged, sure = np.concatenate(points), np.concatenate(confidence).astype(np.float64)
    if len(merged) > MAXIMUM_POINTS:
        kept = np.linspace(0, len(merged) - 1, MAXIMUM_POINTS).round().astype(int)
        merged, sure = merged[kept], sure[kept]
    return merged, sure
