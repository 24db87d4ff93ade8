"""The published CAT-Free method, stage by stage."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from catfree.geometry import CanonicalFrame
from catfree.methods.paper._assemble import assemble
from catfree.methods.paper._select import select_positions
from catfree.methods.paper.association import (
    Observations,
    associate_in_two_passes,
    cast_rays,
    link_tracklets,
    locate,
    observe,
)
from catfree.methods.paper.trajectories import build_trajectories
from catfree.settings import Settings
from catfree.types import Detections, Localization, Rays, Scene
from catfree.types._annotations import Progress, as_progress


class Associated(NamedTuple):
    """Detections in groups of one person each, before any position is known.

    Attributes:
        observations: detections in canonical order.
        rays: their weighted rays in the canonical frame.
        groups: (G, C) detection of each camera in each group, or -1.
        tracklet: (N,) tracklet of each detection, or -1.
        pose_ratio: weight of rays without confirmed ankles.
        detection_count: number of the caller's detections.
    """

    observations: Observations
    rays: Rays
    groups: Int[np.ndarray, "g cam"]
    tracklet: Int[np.ndarray, " n"]
    pose_ratio: float
    detection_count: int


def localize_by_paper(
    detections: Detections,
    scene: Scene,
    keep: Bool[np.ndarray, " n"],
    settings: Settings,
    progress: Progress | None = None,
) -> Localization:
    """Track people by the paper's method.

    Args:
        detections: boxes of all cameras.
        scene: cameras and ground.
        keep: (N,) detections to use, at least one.
        settings: settings of the run.
        progress: called as `progress(stage, done, total)`.

    Returns:
        The result in the caller's frame, units and detection indices.

    Source:
        Sec. "Method".
    """
    associated = associate_detections(detections, scene, keep, settings, progress)
    return locate_people(associated, scene, settings, progress)


def associate_detections(
    detections: Detections,
    scene: Scene,
    keep: Bool[np.ndarray, " n"],
    settings: Settings,
    progress: Progress | None = None,
) -> Associated:
    """Group the detections of each frame by person; see `localize_by_paper`."""
    report = as_progress(progress)
    rig = CanonicalFrame.of(scene).rig(scene.rig)
    observations = observe(detections, rig, keep=keep)
    rays = cast_rays(observations, rig)
    report("tracklets", 0, 1)
    tracklet = link_tracklets(observations, settings.tracklets)
    groups, rays, ratio = associate_in_two_passes(observations, rays, settings, report)
    return Associated(observations, rays, groups, tracklet, ratio, len(detections))


def locate_people(
    associated: Associated, scene: Scene, settings: Settings, progress: Progress | None = None
) -> Localization:
    """Locate the groups, select positions, and link them into tracks; see `localize_by_paper`."""
    report = as_progress(progress)
    observations, rays, groups, tracklet, pose_ratio, detection_count = associated
    rig = CanonicalFrame.of(scene).rig(scene.rig)
    report("positions", 0, 1)
    located = locate(observations, rays, rig, groups, tracklet, settings)
    report("selection", 0, 1)
    selection = select_positions(
        located.hypotheses, settings.selection, sigma_theta=settings.rays.sigma_theta
    )
    report("trajectories", 0, 1)
    positions, extension_appearance = build_trajectories(
        observations, rays, located, selection, settings
    )
    report("trajectories", 1, 1)
    return assemble(
        scene,
        observations,
        rays,
        located,
        selection,
        positions,
        settings,
        pose_ratio=pose_ratio,
        extension_appearance=extension_appearance,
        detection_count=detection_count,
    )
