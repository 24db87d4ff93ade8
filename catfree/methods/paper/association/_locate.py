"""Position hypotheses of the groups, with all measurements that the filters need."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from catfree.methods.paper._select import Hypotheses
from catfree.methods.paper.association._hypotheses import (
    RayTable,
    Support,
    exclusive_support,
    find_support,
    measure_support,
    ray_table,
    triangulate_groups,
)
from catfree.methods.paper.association._hypothesis_scores import hypothesis_scores
from catfree.methods.paper.association._observe import Observations
from catfree.settings import Settings
from catfree.types import Rays, Rig


class Located(NamedTuple):
    """Position hypotheses with their measurements, in the canonical frame.

    Attributes:
        position: (H, 3) free 3-D positions.
        support: the recounted support of each.
        hypotheses: the input of the filters.
        table: all rays by frame and camera, for further recounts.
    """

    position: Float[np.ndarray, "h 3"]
    support: Support
    hypotheses: Hypotheses
    table: RayTable


def locate(
    observations: Observations,
    rays: Rays,
    rig: Rig,
    groups: Int[np.ndarray, "g cam"],
    tracklet: Int[np.ndarray, " n"],
    settings: Settings,
) -> Located:
    """Triangulate the groups, recount their support, measure sigma, g and the score.

    Args:
        observations: detections in canonical order.
        rays: their weighted rays in the canonical frame.
        rig: cameras in the canonical frame.
        groups: (G, C) observation of each camera in each group, or -1.
        tracklet: (N,) tracklet of each observation.
        settings: estimator and radii.

    Returns:
        The hypotheses, one per group.

    Source:
        Sec. "Robust 3D position estimation" and "Selecting pedestrian positions".
    """
    sigma_theta = settings.rays.sigma_theta
    frame_index = observations.frame_index[groups.max(axis=1)]
    position, residual = triangulate_groups(
        rays, groups, settings.triangulation, sigma_theta=sigma_theta
    )
    table = ray_table(observations, rays, np.asarray(rig.centers))
    radius = settings.selection.support_factor * sigma_theta
    if settings.triangulation.estimator == "best_pair":
        # This baseline uses two cameras: no other camera may support its position.
        member = groups = np.where(np.isfinite(residual), groups, -1)
    else:
        member = find_support(table, frame_index, position, radius=radius)
    support = measure_support(rays, member, position, sigma_theta=sigma_theta)
    if settings.selection.exclusive_support:
        member = exclusive_support(support)
        support = measure_support(rays, member, position, sigma_theta=sigma_theta)
    group_tracklet = np.where(groups >= 0, tracklet[groups], -1)
    score = np.zeros(len(position), position.dtype)
    if settings.selection.use_score:
        score = hypothesis_scores(observations, rig, position, support, frame_index, group_tracklet)
    used = np.maximum(np.isfinite(residual).sum(axis=1), 1)
    hypotheses = Hypotheses(
        frame_index=frame_index,
        ground_xy=position[:, :2],
        ground_distance=np.abs(position[:, 2]),
        rms_angle=np.sqrt(np.nansum(residual**2, axis=1) / used),
        sigma=support.sigma,
        weight=support.weight,
        cameras=support.cameras,
        tracklet=group_tracklet,
        supporting_tracklet=np.where(member >= 0, tracklet[member], -1),
        score=score,
    )
    return Located(position, support, hypotheses, table)
