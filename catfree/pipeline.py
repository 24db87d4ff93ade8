"""`localize`: from person boxes and a scene to tracked ground positions, stage by stage."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from catfree.association import (
    CanonicalFrame,
    Observations,
    RayTable,
    Support,
    candidate_pairs,
    cast_rays,
    exclusive_support,
    find_support,
    greedy_partition,
    hypothesis_scores,
    link_tracklets,
    measure_support,
    observe,
    pose_ratio,
    ray_table,
    ray_weights,
    triangulate_groups,
)
from catfree.association.rays import padded_length
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.filters.selection import Hypotheses, Selection, select_positions
from catfree.outcome import collect_candidates, collect_tracks, empty_localization, summarize
from catfree.settings import Settings
from catfree.trajectories import (
    Positions,
    drop_short,
    extend_tracks,
    fill_gaps,
    link_positions,
)
from catfree.types import Detections, Localization, Origin, Rays, Scene, Thresholds

Progress = Callable[[str, int, int], None]

CHUNK = 8192  # detections associated together: bounds memory, and no sequence recompiles


class _Groups(NamedTuple):
    """Cross-view groups of a sequence.

    Attributes:
        member: (G, C) observation of each camera, or -1.
        frame_index: (G,) frame of each group.
    """

    member: Int[np.ndarray, "g cam"]
    frame_index: Int[np.ndarray, " g"]


def localize(
    detections: Detections,
    scene: Scene,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Localization:
    """Track people on the ground from their boxes in several calibrated views.

    Args:
        detections: person boxes of all cameras and frames, in any order.
        scene: cameras, ground and extent in any units and any frame of reference.
        settings: `Settings()`, the default method, if None.
        progress: called as `progress(stage, done, total)`.

    Returns:
        Tracks, every candidate with its fate, the thresholds and a label-free reliability summary,
        in the frame and units of the scene. A similarity transform of the scene transforms the
        result and changes nothing else; the order of cameras, detections and frames has no effect.

    Raises:
        InvalidInputError: if a detection names a camera that the rig does not have.
        InsufficientDataError: if fewer than two cameras are registered.

    Source:
        Sec. "Method" of the paper for `Settings.paper()`.
    """
    settings = settings or Settings()
    report = progress or (lambda stage, done, total: None)
    keep = _usable(detections, scene, settings)

    frame = CanonicalFrame.of(scene)
    rig = frame.rig(scene.rig)
    observations = observe(detections, rig, keep=keep)
    if len(observations) == 0:
        return empty_localization(rig.camera_count)
    report("tracklets", 0, 1)
    tracklet = link_tracklets(observations, settings.tracklets)
    rays = cast_rays(observations, rig, length=padded_length(len(observations)))

    # Two passes: the first one, unweighted, teaches how far each ray can be trusted.
    ratio, median_height = 1.0, float(np.median(observations.height))
    if settings.rays.use_ankles and observations.ankles_confirmed is not None:
        groups = _associate(observations, rays, settings, report)
        ratio = _learn_pose_ratio(observations, rays, groups, settings)
    weight = ray_weights(
        observations.height, observations.ankles_confirmed, ratio, median_height, settings.rays
    )
    rays = _weighted(rays, weight)
    groups = _associate(observations, rays, settings, report)

    report("positions", 0, 1)
    sigma_theta = settings.rays.sigma_theta
    position, residual = triangulate_groups(
        rays, groups.member, settings.triangulation, sigma_theta=sigma_theta
    )
    table = ray_table(observations, rays, np.asarray(rig.centers))
    radius = settings.selection.support_factor * sigma_theta
    member = find_support(table, groups.frame_index, position, radius=radius)
    support = measure_support(rays, member, position, sigma_theta=sigma_theta)
    if settings.selection.exclusive_support:
        member = exclusive_support(support)
        support = measure_support(rays, member, position, sigma_theta=sigma_theta)

    report("selection", 0, 1)
    hypotheses = Hypotheses(
        frame_index=groups.frame_index,
        ground_xy=position[:, :2],
        ground_distance=np.abs(position[:, 2]),
        rms_angle=np.sqrt(np.nanmean(residual**2, axis=1)) if len(residual) else position[:, 2],
        sigma=support.sigma,
        weight=support.weight,
        cameras=support.cameras,
        tracklet=np.where(groups.member >= 0, tracklet[groups.member], -1),
        supporting_tracklet=np.where(support.member >= 0, tracklet[support.member], -1),
        score=np.zeros(len(position), position.dtype),
    )
    if settings.selection.use_score:
        score = hypothesis_scores(
            observations, rig, position, support, groups.frame_index, hypotheses.tracklet
        )
        hypotheses = hypotheses._replace(score=score)
    selection = select_positions(hypotheses, settings.selection, sigma_theta=sigma_theta)

    report("trajectories", 0, 1)
    positions, extension_appearance = _trajectories(
        observations, rays, table, hypotheses, support, selection, settings
    )
    report("trajectories", 1, 1)
    thresholds = Thresholds(
        tau_sigma=_times(selection.tau_sigma, frame.extent),
        tau_g=_times(selection.tau_g, frame.extent),
        tau_sigma_recovery=_times(selection.tau_sigma_recovery, frame.extent),
        tau_g_recovery=_times(selection.tau_g_recovery, frame.extent),
        median_box_height=median_height,
        pose_ratio=ratio,
        extension_appearance=extension_appearance,
    )
    candidates = collect_candidates(frame, observations, hypotheses, position, support, selection)
    tracks = collect_tracks(frame, scene, observations, rays, positions, sigma_theta=sigma_theta)
    radius = settings.selection.suppression_radius * frame.extent
    return Localization(
        tracks, candidates, thresholds, summarize(tracks, candidates, len(observations), radius)
    )


def _usable(detections: Detections, scene: Scene, settings: Settings) -> np.ndarray:
    """Which detections take part: confident enough, and seen by a registered camera."""
    rig = scene.rig
    unknown = detections.camera >= rig.camera_count
    if unknown.any():
        at = int(np.argmax(unknown))
        raise InvalidInputError(
            f"camera[{at}] is {detections.camera[at]}, but the rig has {rig.camera_count} cameras, "
            f"0 to {rig.camera_count - 1}. Pass the rig that the detections were made with."
        )
    if rig.registered.sum() < 2:
        raise InsufficientDataError(
            f"Localization needs at least 2 registered cameras to intersect rays; this rig has "
            f"{int(rig.registered.sum())} of {rig.camera_count}. Add cameras or register them."
        )
    keep = rig.registered[detections.camera]
    if detections.score is not None:
        keep = keep & (detections.score >= settings.confidence)
    if settings.rays.only_confirmed_ankles and detections.ankles_confirmed is not None:
        keep = keep & detections.ankles_confirmed
    return keep


def _associate(
    observations: Observations, rays: Rays, settings: Settings, report: Progress
) -> _Groups:
    """Cross-view groups of all frames, a chunk of frames at a time."""
    origin, direction, weight = map(np.asarray, (rays.origin, rays.direction, rays.weight))
    tolerance = settings.association.residual_factor * settings.rays.sigma_theta
    frames = len(observations.frames)
    starts = observations.frame_start(np.arange(frames + 1))
    members: list[np.ndarray] = []
    first = 0
    while first < frames:
        report("association", first, frames)
        last = int(np.searchsorted(starts, starts[first] + CHUNK, side="right")) - 1
        last = max(last, first + 1)  # a frame is never cut
        begin, end = int(starts[first]), int(starts[last])
        padding = padded_length(end - begin) - (end - begin)
        chunk = Rays(
            np.pad(origin[begin:end], ((0, padding), (0, 0))),
            np.pad(direction[begin:end], ((0, padding), (0, 0))),
            np.pad(weight[begin:end], (0, padding)),
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
            np.pad(observations.camera[begin:end], (0, padding)),
            pairs,
            camera_count=observations.camera_count,
            tolerance=tolerance,
            constrain_to_ground=settings.triangulation.constrain_to_ground,
        )
        members.append(np.where(groups >= 0, groups + begin, -1))
        first = last
    report("association", frames, frames)
    member = np.concatenate(members)
    return _Groups(member, observations.frame_index[member.max(axis=1)])


def _learn_pose_ratio(
    observations: Observations, rays: Rays, groups: _Groups, settings: Settings
) -> float:
    """The pose ratio, from the residuals of an unweighted triangulation."""
    assert observations.ankles_confirmed is not None
    _, residual = triangulate_groups(
        rays, groups.member, settings.triangulation, sigma_theta=settings.rays.sigma_theta
    )
    of_observation = np.full(len(observations), np.nan)
    present = groups.member >= 0
    of_observation[groups.member[present]] = residual[present]
    return pose_ratio(of_observation, observations.ankles_confirmed)


def _weighted(rays: Rays, weight: Float[np.ndarray, " n"]) -> Rays:
    dtype = np.asarray(rays.direction).dtype
    padded = np.pad(weight.astype(dtype), (0, len(rays.weight) - len(weight)))
    return Rays(rays.origin, rays.direction, padded)


def _trajectories(
    observations: Observations,
    rays: Rays,
    table: RayTable,
    hypotheses: Hypotheses,
    support: Support,
    selection: Selection,
    settings: Settings,
) -> tuple[Positions, float | None]:
    """Link the accepted positions, drop short tracks, extend the rest."""
    rules = settings.trajectories
    chosen = np.flatnonzero(selection.accepted)
    chosen = chosen[np.argsort(hypotheses.frame_index[chosen], kind="stable")]
    positions = Positions(
        hypotheses.frame_index[chosen],
        hypotheses.ground_xy[chosen],
        support.member[chosen],
        np.full(len(chosen), -1),
        np.full(len(chosen), int(Origin.DETECTED)),
    )
    if not rules.enabled:
        return positions, None
    track = link_positions(positions, observations.time, observations.appearance, rules)
    lasting = drop_short(track, positions.ground_xy, rules)
    positions = Positions(*(column[lasting] for column in positions._replace(track=track)))
    positions = positions._replace(track=_renumber(positions.track))
    if rules.interpolate_gaps:
        positions = fill_gaps(positions, observations.time)
    if not rules.extend:
        return positions, None
    radius = rules.extension_support_factor * settings.rays.sigma_theta

    def recount(
        frame_index: Int[np.ndarray, " k"], xy: Float[np.ndarray, "k 2"]
    ) -> tuple[Int[np.ndarray, "k cam"], Float[np.ndarray, " k"]]:
        member = find_support(table, frame_index, np.pad(xy, ((0, 0), (0, 1))), radius=radius)
        weight = np.where(member >= 0, np.asarray(rays.weight)[member], 0).sum(axis=1)
        return member, weight

    return extend_tracks(
        positions,
        observations.time,
        observations.appearance,
        recount,
        rules,
        occupied_radius=settings.selection.suppression_radius,
    )


def _renumber(track: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    return np.unique(track, return_inverse=True)[1] if len(track) else track


def _times(value: float | None, length: float) -> float | None:
    return None if value is None else value * length
