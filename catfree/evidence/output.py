"""The solution as catfree's result types, in scene units."""

import jax
import numpy as np

from catfree.evidence.constants import EvidenceSettings
from catfree.evidence.existence import predict_views
from catfree.evidence.solve import Progress, Solution, solve
from catfree.evidence.visibility import Views
from catfree.evidence.working_area import in_working_area
from catfree.types import (
    Candidates,
    Detections,
    Fate,
    Localization,
    Origin,
    Reliability,
    Scene,
    Thresholds,
    Tracks,
)


def locate(
    detections: Detections,
    scene: Scene,
    settings: EvidenceSettings | None = None,
    *,
    progress: Progress | None = None,
) -> Localization:
    """Tracked ground positions by the evidence method."""
    settings = settings or EvidenceSettings()
    solution = solve(detections, scene, settings, progress=progress)
    return describe(solution, scene, settings)


def describe(solution: Solution, scene: Scene, settings: EvidenceSettings) -> Localization:
    s = solution
    unit, origin = float(s.views.unit), s.views.origin
    basis = np.asarray(scene.ground.basis, np.float64)
    normal, offset = np.asarray(scene.ground.normal, np.float64), float(scene.ground.offset)
    trails = s.trails
    keep = s.kept.copy()
    sigma = np.sqrt((trails.covariance[:, 0, 0] + trails.covariance[:, 1, 1]) / 2)
    n_members = (s.groups.member >= 0).sum(1)
    keep &= report_probability(trails.covariance[:, :2, :2], settings.report_radius) > 0.5
    if settings.working_area:
        with jax.enable_x64(True):
            member = np.full((len(trails), s.boxes.table.shape[1]), -1)
            seen = predict_views(trails.mean[:, :3], trails.frame, member, s.boxes, s.views)
            chosen = np.flatnonzero(keep)
            part = Views(seen.inside[chosen], seen.height[chosen], seen.cover[chosen])
            keep[chosen] &= in_working_area(
                trails.mean[chosen, :3], part, s.views, s.noise, settings
            )
    rows = np.flatnonzero(keep)
    rows = rows[np.lexsort((trails.track[rows], trails.frame[rows]))]
    t = trails[rows]
    xy = t.mean[:, :2] * unit + origin
    seen = t.group >= 0
    tracks = Tracks(
        frame=s.boxes.frames[t.frame], track_id=np.unique(t.track, return_inverse=True)[1],
        position=xy @ basis.T - offset * normal, ground_xy=xy, sigma=sigma[rows] * unit,
        covariance=(t.covariance[:, :2, :2] + settings.sway**2 * np.eye(2)) * unit**2,
        supporting_cameras=np.where(seen, n_members[np.maximum(t.group, 0)], 0),
        origin=np.where(seen, Origin.DETECTED, Origin.INTERPOLATED),
        existence=s.probability[rows],
    )  # fmt: skip
    H = len(s.groups)
    gxy = s.state[:, :2] * unit + origin
    support = np.where(s.groups.member >= 0, s.boxes.row[np.maximum(s.groups.member, 0)], -1)
    fate = np.where(s.existence.log_odds > 0, Fate.TRACKING, Fate.EXISTENCE)
    fate[t.group[seen]] = Fate.ACCEPTED
    candidates = Candidates(
        frame=s.boxes.frames[s.groups.frame], position=gxy @ basis.T - offset * normal,
        sigma=unit * np.sqrt((s.covariance[:, 0, 0] + s.covariance[:, 1, 1]) / 2),
        ground_distance=np.zeros(H), rms_angle=np.zeros(H), support=support,
        score=s.existence.log_odds, fate=fate,
    )  # fmt: skip
    return Localization(tracks, candidates, Thresholds(), Reliability(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def report_probability(covariance: np.ndarray, radius: float) -> np.ndarray:
    """(M,) probability that the true position is within a radius; lengths in H0."""
    values = np.linalg.eigvalsh(covariance)
    a, b = np.sqrt(np.maximum(values[:, 0], 1e-12)), np.sqrt(np.maximum(values[:, 1], 1e-12))
    angle = (np.arange(64) + 0.5) * (2 * np.pi / 64)
    # Integrate the Gaussian over the disc in polar coordinates of the whitened plane.
    u, v = np.cos(angle)[None], np.sin(angle)[None]
    r = radius / np.sqrt((a[:, None] * u) ** 2 + (b[:, None] * v) ** 2)
    return (1 - np.exp(-0.5 * r**2)).mean(1)
