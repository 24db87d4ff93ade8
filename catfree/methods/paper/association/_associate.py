"""Cross-view groups of a whole sequence, computed in chunks of frames."""

import dataclasses

import numpy as np
from jaxtyping import Int

from catfree.geometry._buckets import padded_length
from catfree.methods.paper.association._candidate_pairs import candidate_pairs
from catfree.methods.paper.association._greedy_partition import greedy_partition
from catfree.methods.paper.association._hypotheses import triangulate_groups
from catfree.methods.paper.association._observe import Observations
from catfree.methods.paper.association._ray_weights import measured_pose_ratio, ray_weights
from catfree.settings import Settings
from catfree.types import Rays
from catfree.types._annotations import Progress, no_progress

CHUNK = 8192  # detections associated together: bounds memory and avoids recompilation


def associate(
    observations: Observations,
    rays: Rays,
    settings: Settings,
    report: Progress = no_progress,
) -> Int[np.ndarray, "g cam"]:
    """Partition the detections of every frame into groups of one person each.

    Args:
        observations: detections in canonical order.
        rays: their rays in the canonical frame, with their weights.
        settings: thresholds of the association.
        report: called as `report("association", frames done, frames)`.

    Returns:
        (G, C) observation of each camera in each group, or -1, in order of frames; at least two
        per group.

    Source:
        Sec. "Matching pedestrians across cameras".
    """
    frames = len(observations.frames)
    starts = observations.frame_start(np.arange(frames + 1))
    members = [np.zeros((0, observations.camera_count), np.int64)]
    first = 0
    while first < frames:
        report("association", first, frames)
        last = int(np.searchsorted(starts, starts[first] + CHUNK, side="right")) - 1
        last = max(last, first + 1)  # never split a frame
        begin, end = int(starts[first]), int(starts[last])
        padding = (0, padded_length(end - begin, CHUNK) - (end - begin))
        chunk = Rays(
            np.pad(rays.origin[begin:end], (padding, (0, 0))),
            np.pad(rays.direction[begin:end], (padding, (0, 0))),
            np.pad(rays.weight[begin:end], padding),
        )
        pairs = candidate_pairs(
            observations,
            chunk,
            (first, last),
            sigma_theta=settings.rays.sigma_theta,
            settings=settings.association,
        )
        groups = greedy_partition(
            chunk,
            np.pad(observations.kept.camera[begin:end], padding),
            pairs,
            camera_count=observations.camera_count,
            tolerance=settings.association.residual_factor * settings.rays.sigma_theta,
            constrain_to_ground=settings.triangulation.constrain_to_ground,
        )
        members.append(np.where(groups >= 0, groups + begin, -1))
        first = last
    report("association", frames, frames)
    return np.concatenate(members)


def associate_in_two_passes(
    observations: Observations,
    rays: Rays,
    settings: Settings,
    report: Progress = no_progress,
) -> tuple[Int[np.ndarray, "g cam"], Rays, float]:
    """Group the detections twice: the first, unweighted pass provides the pose ratio of the second.

    Args:
        observations: detections in canonical order.
        rays: their rays in the canonical frame, all of weight 1.
        settings: thresholds of the association, and the reliability cues to use.
        report: as in `associate`.

    Returns:
        The groups, the rays with their weights, and the pose ratio.

    Source:
        Sec. "Pedestrian observations and ray reliability".
    """
    ratio = 1.0
    if settings.rays.use_ankles and observations.kept.ankles_confirmed is not None:
        groups = associate(observations, rays, settings, report)
        ratio = learn_pose_ratio(observations, rays, groups, settings)
    rays = weigh_rays(observations, rays, ratio, settings)
    return associate(observations, rays, settings, report), rays, ratio


def weigh_rays(observations: Observations, rays: Rays, ratio: float, settings: Settings) -> Rays:
    """Weight the rays by Eq. w for a pose ratio, with box heights relative to their median."""
    height = observations.kept.height
    median = float(np.median(height)) if len(height) else 1.0
    weight = ray_weights(height, observations.kept.ankles_confirmed, ratio, median, settings.rays)
    return Rays(rays.origin, rays.direction, weight.astype(rays.direction.dtype))


def learn_pose_ratio(
    observations: Observations, rays: Rays, groups: Int[np.ndarray, "g cam"], settings: Settings
) -> float:
    """Estimate the pose ratio from the residuals of an unweighted triangulation.

    Args:
        observations: detections with ankle flags.
        rays: their rays, all of weight 1.
        groups: their unweighted groups.
        settings: the estimator.

    Returns:
        Weight of rays without confirmed ankles in (0, 1].

    Source:
        Sec. "Pedestrian observations and ray reliability".
    """
    if observations.kept.ankles_confirmed is None:
        return 1.0
    # Always the full estimator: the baselines change positions, not the reliability of rays, and a
    # single ray has no residual.
    triangulation = dataclasses.replace(settings.triangulation, estimator="rays")
    _, residual = triangulate_groups(
        rays, groups, triangulation, sigma_theta=settings.rays.sigma_theta
    )
    of_observation = np.full(len(observations), np.nan)
    present = groups >= 0
    of_observation[groups[present]] = residual[present]
    return measured_pose_ratio(of_observation, observations.kept.ankles_confirmed)
