"""From canonical arrays to the result in the caller's frame and units."""

import numpy as np

from catfree.geometry import CanonicalFrame
from catfree.geometry._plane import to_plan
from catfree.methods.paper._select import Selection
from catfree.methods.paper.association import (
    Located,
    Observations,
    exclusive_support,
    measure_support,
)
from catfree.methods.paper.trajectories import Positions, difference_velocities
from catfree.settings import Settings
from catfree.types import (
    Candidates,
    Fate,
    Localization,
    Origin,
    Rays,
    Reliability,
    Scene,
    Thresholds,
    Tracks,
)


def assemble(
    scene: Scene,
    observations: Observations,
    rays: Rays,
    located: Located,
    selection: Selection,
    positions: Positions,
    settings: Settings,
    *,
    pose_ratio: float,
    extension_appearance: float | None,
    detection_count: int,
) -> Localization:
    """Assemble the result in scene units, with the caller's frames and detection indices."""
    frame, sigma_theta = CanonicalFrame.of(scene), settings.rays.sigma_theta
    candidates = collect_candidates(frame, observations, located, selection)
    tracks = collect_tracks(frame, scene, observations, rays, positions, sigma_theta=sigma_theta)
    radius = settings.selection.suppression_radius * frame.extent
    reliability = summarize(tracks, candidates, len(observations), radius)
    lengths = ("tau_sigma", "tau_g", "tau_sigma_recovery", "tau_g_recovery")
    thresholds = Thresholds(
        **{name: _times(getattr(selection, name), frame.extent) for name in lengths},
        median_box_height=float(np.median(observations.kept.height)),
        pose_ratio=pose_ratio,
        extension_appearance=extension_appearance,
    )
    return Localization(tracks, candidates, thresholds, reliability, detection_count)


def collect_candidates(
    frame: CanonicalFrame,
    observations: Observations,
    located: Located,
    selection: Selection,
) -> Candidates:
    """Collect all hypotheses with their fates, in scene units and the caller's indices."""
    hypotheses, support = located.hypotheses, located.support
    member = support.member
    return Candidates(
        frame=observations.frames[hypotheses.frame_index],
        position=frame.to_world(located.position),
        sigma=support.sigma.astype(np.float64) * frame.extent,
        ground_distance=hypotheses.ground_distance.astype(np.float64) * frame.extent,
        rms_angle=hypotheses.rms_angle.astype(np.float64),
        support=np.where(member >= 0, observations.row[member], -1),
        score=hypotheses.score.astype(np.float64),
        fate=selection.fate,
    )


def collect_tracks(
    frame: CanonicalFrame,
    scene: Scene,
    observations: Observations,
    rays: Rays,
    positions: Positions,
    *,
    sigma_theta: float,
) -> Tracks:
    """Collect the positions of all tracks on the ground, with support and uncertainty."""
    points = np.pad(positions.ground_xy, ((0, 0), (0, 1)))
    support = measure_support(rays, positions.member, points, sigma_theta=sigma_theta)
    world = frame.to_world(points)
    xy = to_plan(scene, world)
    covariance = support.covariance.astype(np.float64) * frame.extent**2
    number = observations.frames[positions.frame_index]
    # Positions may share a detection, but it shows one person: the one whom its ray passes closest.
    shown = exclusive_support(support)
    velocity, spread = difference_velocities(positions.track, number, xy, covariance)
    return Tracks(
        frame=number,
        track_id=positions.track,
        position=world,
        ground_xy=xy,
        sigma=support.sigma.astype(np.float64) * frame.extent,
        covariance=covariance,
        supporting_cameras=support.cameras,
        origin=positions.origin,
        support=np.where(shown >= 0, observations.row[shown], -1),
        velocity=velocity,
        velocity_covariance=spread,
    ).renumbered()


def summarize(
    tracks: Tracks, candidates: Candidates, detection_count: int, radius: float
) -> Reliability:
    """Summarize a run without labels.

    Args:
        tracks: the run's tracks.
        candidates: its candidates.
        detection_count: detections that took part.
        radius: distance in scene units within which two positions are the same, or a position is
            correct.
    """
    accepted = (candidates.fate == Fate.ACCEPTED) | (candidates.fate == Fate.RECOVERED)
    used = np.unique(candidates.support[accepted])
    median = float(np.median(tracks.sigma)) if len(tracks) else np.nan
    return Reliability(
        median_sigma=median,
        sigma_over_radius=median / radius,
        fraction_recovered=_share(candidates.fate[accepted] == Fate.RECOVERED),
        fraction_extended=_share(tracks.origin == Origin.EXTENDED),
        mean_supporting_cameras=float(np.mean(tracks.supporting_cameras)) if len(tracks) else 0.0,
        detections_used=float((used >= 0).sum() / detection_count) if detection_count else 0.0,
    )


def empty_localization(
    camera_count: int, *, existence: bool = False, detection_count: int = 0
) -> Localization:
    """Make the result of a sequence in which no detection takes part.

    Args:
        camera_count: C.
        existence: whether the method gives probabilities of existence.
        detection_count: number of the caller's detections.
    """
    integers, numbers = np.zeros(0, np.int64), np.zeros(0)
    tracks = Tracks(
        frame=integers,
        track_id=integers,
        position=np.zeros((0, 3)),
        ground_xy=np.zeros((0, 2)),
        sigma=numbers,
        covariance=np.zeros((0, 2, 2)),
        supporting_cameras=integers,
        origin=integers,
        existence=numbers if existence else None,
        support=np.zeros((0, camera_count), np.int64),
    )
    candidates = Candidates(
        frame=integers,
        position=np.zeros((0, 3)),
        sigma=numbers,
        ground_distance=numbers,
        rms_angle=numbers,
        support=np.zeros((0, camera_count), np.int64),
        score=numbers,
        fate=integers,
    )
    reliability = summarize(tracks, candidates, 0, 1.0)
    return Localization(tracks, candidates, Thresholds(), reliability, detection_count)


def _share(flags: np.ndarray) -> float:
    return float(flags.mean()) if len(flags) else 0.0


def _times(value: float | None, length: float) -> float | None:
    return None if value is None else value * length
