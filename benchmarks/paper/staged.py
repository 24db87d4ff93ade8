"""`cf.localize` with the paper's method, caching the first stages between variants.

Association takes most of the time and does not depend on filters or trajectories, which
most tables vary. The result is that of `cf.localize`; `tests/benchmarks` compares them.
"""

import dataclasses
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

import catfree as cf
from benchmarks.paper.sequences import Sequence
from catfree.geometry import CanonicalFrame
from catfree.methods._localize import usable
from catfree.methods.paper._assemble import assemble
from catfree.methods.paper._select import select_positions
from catfree.methods.paper.association import (
    Correspondences,
    Observations,
    associate_in_two_passes,
    cast_rays,
    link_tracklets,
    locate,
    observe,
)
from catfree.methods.paper.trajectories import build_trajectories
from catfree.settings import SelectionSettings, TrajectorySettings
from catfree.types import Rays, Rig, Thresholds


class Associated(NamedTuple):
    """What the stages up to the association leave behind."""

    frame: CanonicalFrame
    rig: Rig
    observations: Observations
    rays: Rays
    groups: Correspondences
    tracklet: Int[np.ndarray, " n"]


def localize_staged(sequence: Sequence, scene: cf.Scene, settings: cf.Settings) -> cf.Localization:
    """Localize by the paper's method, or as `cf.localize` does for any other.

    Args:
        sequence: whose boxes to localize.
        scene: the recovered or the true scene of the sequence.
        settings: of the run.

    Returns:
        The result; its thresholds are not filled in.
    """
    if settings.method != "paper":
        return cf.localize(sequence.detections, scene, settings)
    # Filters and trajectories come later: every variant of them shares one association.
    first = dataclasses.replace(
        settings, selection=SelectionSettings(), trajectories=TrajectorySettings()
    )
    found = _associate(sequence, scene is sequence.true_scene, first)
    if found is None:
        return cf.localize(sequence.detections, scene, settings)
    located = locate(
        found.observations, found.rays, found.rig, found.groups, found.tracklet, settings
    )
    selection = select_positions(
        located.hypotheses, settings.selection, sigma_theta=settings.rays.sigma_theta
    )
    positions, _ = build_trajectories(found.observations, found.rays, located, selection, settings)
    extent = found.frame.extent
    thresholds = Thresholds(
        tau_sigma=None if selection.tau_sigma is None else selection.tau_sigma * extent,
        tau_g=None if selection.tau_g is None else selection.tau_g * extent,
    )
    return assemble(
        found.frame,
        scene,
        found.observations,
        found.rays,
        located,
        selection,
        positions,
        thresholds,
        settings,
        detection_count=len(sequence.detections),
    )


@cache
def _associate(sequence: Sequence, true_rig: bool, settings: cf.Settings) -> Associated | None:
    """The stages of the paper up to the cross-view groups; None without any boxes."""
    scene = sequence.true_scene if true_rig else sequence.scene
    assert scene is not None
    detections = sequence.detections
    keep = usable(detections, scene, settings)
    if not keep.any():
        return None
    frame = CanonicalFrame.of(scene)
    rig = frame.rig(scene.rig)
    observations = observe(detections, rig, keep=keep)
    rays = cast_rays(observations, rig)
    tracklet = link_tracklets(observations, settings.tracklets)
    groups, rays, _ = associate_in_two_passes(observations, rays, settings)
    return Associated(frame, rig, observations, rays, groups, tracklet)
