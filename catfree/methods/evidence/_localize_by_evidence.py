"""`localize_by_evidence`: convert the solution to result types in scene units."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int
from scipy.special import expit

from catfree.geometry._plane import from_plan
from catfree.methods.evidence._gaussian import probability_within
from catfree.methods.evidence._solve import solve
from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.observe._boxes import float_width_of
from catfree.methods.evidence.report._blind_cameras import blind_camera_warnings
from catfree.methods.evidence.report._lens_pattern import lens_bends, lens_warnings
from catfree.methods.evidence.report._ray_diagnostics import ray_diagnostics
from catfree.methods.evidence.report._reported import Reported, tracks_of
from catfree.methods.evidence.report._residual_patterns import residual_patterns
from catfree.methods.paper._assemble import summarize
from catfree.settings import EvidenceSettings
from catfree.types import Candidates, Detections, Fate, Localization, Scene, Thresholds
from catfree.types._annotations import Progress

GROUND_TOLERANCE = 0.15  # of a person's height; feet farther off the ground are reported
USUAL_HEIGHTS = (1.0, 2.5)  # meters; a median height outside indicates another unit


def localize_by_evidence(
    detections: Detections,
    scene: Scene,
    settings: EvidenceSettings | None = None,
    *,
    keep: Bool[np.ndarray, " n"] | None = None,
    silent: Int[np.ndarray, "k 2"] | None = None,
    camera_names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Localization:
    """Track people on the ground by the evidence method.

    Args:
        detections: boxes of all cameras and frames, in any order.
        scene: rig and ground in any units and frame of reference.
        settings: constants and switches.
        keep: (N,) detections to use; None for all.
        silent: (K, 2) frame and camera of missing pictures.
        camera_names: names for warnings.
        progress: called as `progress(stage, done, total)`.

    Returns:
        Tracks with covariance, velocity and existence probability, and every candidate with its
        fate, in the frame and units of the scene.

    Raises:
        InsufficientDataError: if no box of a registered camera stands on the ground.
    """
    settings = settings or EvidenceSettings()
    solution = solve(detections, scene, settings, keep=keep, silent=silent, progress=progress)
    return describe(solution, detections, scene, settings, camera_names)


def describe(
    solution: EvidenceState,
    detections: Detections,
    scene: Scene,
    settings: EvidenceSettings,
    camera_names: Sequence[str] | None = None,
) -> Localization:
    """Convert a solution to the frame and units of its scene.

    Args:
        solution: the result of `solve`.
        detections: the boxes passed to `solve`.
        scene: the scene passed to `solve`.
        settings: the settings passed to `solve`.
        camera_names: names for warnings.

    Returns:
        The localization.
    """
    s = solution
    unit = float(s.views.unit)
    rows = np.flatnonzero(s.kept)
    group = s.trails.group[rows]
    is_detected = group >= 0
    fate = np.where(s.existence.log_odds > 0, Fate.TRACKING, Fate.EXISTENCE).astype(np.int64)
    present = np.flatnonzero((s.trails.group >= 0) & (s.fate != Fate.TRACKING))
    fate[s.trails.group[present]] = s.fate[present]
    with float_width_of(s.boxes.box):  # before the results take up memory
        rays = ray_diagnostics(s.boxes, s.measurements, s.groups, s.views)
        bend = lens_bends(s)
        patterns = residual_patterns(s)
    precision, recall = _expected_rates(s, rows, fate, settings.report_radius)
    members = np.where(s.groups.member >= 0, s.boxes.row[s.groups.member], -1)
    support = np.where(is_detected[:, None], members[group], -1)
    reported = Reported(
        s.boxes.frames[s.trails.frame[rows]], s.identity[rows], s.trails.mean[rows],
        s.trails.covariance[rows, 3:, 3:], s.position_covariance[rows], s.probability[rows],
        support, s.coverage[rows],
    )  # fmt: skip
    pace = unit / s.boxes.step
    tracks = tracks_of(reported, scene, s.views.origin, unit, pace, detections.clock).renumbered()
    candidates = Candidates(
        frame=s.boxes.frames[s.groups.frame],
        position=from_plan(scene, s.place[:, :2] * unit + s.views.origin),
        sigma=rays.sigma * unit,
        ground_distance=np.abs(rays.height) * unit,
        rms_angle=rays.rms_angle,
        support=members,
        score=s.existence.log_odds,
        fate=fate,
    )
    radius = settings.report_radius * unit
    height = rays.ground_height(fate == Fate.ACCEPTED) * unit
    reliability = replace(
        summarize(tracks, candidates, len(s.boxes.row), radius),
        fraction_extended=float(np.mean(~is_detected)) if len(tracks) else 0.0,
        expected_precision=precision,
        expected_recall=recall,
        ground_height=height,
        lens_bend=float(bend.max(initial=0.0)),
        shift_over_radius=patterns.largest_shift / settings.report_radius if patterns else None,
        least_together=patterns.least_together if patterns else None,
        rig_sd_over_radius=None if scene.rig_sd is None else scene.rig_sd / radius,
    )
    thresholds = Thresholds(median_box_height=float(np.median(s.boxes.size)))
    warnings = ground_warnings(height, unit, scene) + lens_warnings(bend, camera_names)
    warnings += blind_camera_warnings(s, scene, settings, camera_names)
    if patterns is not None:
        warnings += patterns.sentences(camera_names)
    return Localization(tracks, candidates, thresholds, reliability, len(detections), warnings)


def ground_warnings(height: float, person_height: float, scene: Scene) -> tuple[str, ...]:
    """Warn if a scene that claims meters has another unit, and if feet are far off the ground.

    Args:
        height: `Reliability.ground_height`, NaN if unknown.
        person_height: median height in the same unit.
        scene: for the name of the unit.
    """
    warnings = []
    if scene.metric and not USUAL_HEIGHTS[0] <= person_height <= USUAL_HEIGHTS[1]:
        warnings.append(
            f"People are {person_height:.2g} m tall in this scene, so its lengths are not in "
            "meters: pass its unit to cf.read_scene, which may be arbitrary, or scale it."
        )
    if abs(height) > GROUND_TOLERANCE * person_height:
        unit = "m" if scene.metric else "units of the scene"
        side, level = ("above", "low") if height > 0 else ("below", "high")
        warnings.append(
            f"The rays through people's feet meet {abs(height):.2g} {unit} {side} the ground "
            f"plane: the plane is too {level} or the cameras are off. Pass the ground on which "
            "people stand, or refine the scene with `cf.refine`."
        )
    return tuple(warnings)


def _expected_rates(
    solution: EvidenceState, rows: np.ndarray, fate: np.ndarray, radius: float
) -> tuple[float, float]:
    """Expected precision and recall, from the probabilities of reported and rejected candidates.

    Suppressed candidates do not count as missed because they duplicate a reported person.
    """
    s = solution
    within = probability_within(s.position_covariance[rows], radius)
    correct = float((s.probability[rows] * within).sum())
    left_out = s.existence.log_odds[(fate != Fate.ACCEPTED) & (fate != Fate.SUPPRESSED)]
    missed = float(expit(left_out).sum())
    people = correct + missed
    return (
        correct / len(rows) if len(rows) else float("nan"),
        correct / people if people > 0 else float("nan"),
    )
