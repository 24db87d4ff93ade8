"""Refine a rig in rounds with the people that its cameras share."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration._adjusted_cameras import moved_rig, with_registered
from catfree.calibration._bundle_adjustment import (
    CENTER_SD,
    ROTATION_SD,
    adjust,
    project_directions,
)
from catfree.calibration._refine_by_evidence import refine_by_evidence
from catfree.calibration._refinement import CAMERAS, MOST_FRAMES, STEPS, Refinement as Refinement
from catfree.errors import InsufficientDataError
from catfree.geometry import CanonicalFrame
from catfree.geometry._arrays import MEDIAN_TO_DEVIATION
from catfree.geometry._least_squares import HUBER
from catfree.methods.paper.association import (
    Observations,
    associate,
    cast_rays,
    learn_pose_ratio,
    observe,
    triangulate_groups,
    weigh_rays,
)
from catfree.settings import Settings
from catfree.types import Detections, Plane, Rays, Rig, Scene
from catfree.types._annotations import Progress, as_progress
from catfree.types._detections import is_confident
from catfree.types._rig import require_pinholes
from catfree.types._sampling import evenly_spread
from catfree.types._scene import require_scene
from catfree.types._validation import (
    as_count,
    require_different_cameras,
    require_instance,
    require_known_cameras,
)

RESOLVED = 0.25  # fraction of the median height below which box errors stop shrinking
GROUND_ITERATIONS = 20  # reweighting converges to a thousandth of the noise
FLATTEST = 1e-6  # fraction of E: lower bound of the ground noise


@dataclass(frozen=True)
class _Round:
    """A rig and the people found with it.

    Attributes:
        step: (C, 7) step of the cameras from the given ones (`moved_rig`).
        rig: the cameras in the canonical frame.
        rays: rays of all observations.
        member: (P, C) observation in each camera, or -1.
        points: (P, 3) positions.
        residual: median angle in radians.
        ratio: pose ratio for the next round.
    """

    step: Float[np.ndarray, "cam 7"]
    rig: Rig
    rays: Rays
    member: Int[np.ndarray, "person cam"]
    points: Float[np.ndarray, "person 3"]
    residual: float
    ratio: float


def refine(
    detections: Detections,
    scene: Scene,
    settings: Settings | None = None,
    *,
    rounds: int = 25,
    progress: Progress | None = None,
) -> Refinement:
    """Refine cameras and ground with the people that several cameras see.

    With the paper's method, each round associates the detections using the cameras of the previous
    round, takes the people seen by at least three cameras as points, and adjusts cameras and points
    to the foot pixels under a Huber loss; all rounds are run. With the evidence method, each round
    takes the most certain people and adjusts cameras, people and their heights to whole boxes on
    one ground, as `calibrate` does, until the residual stops falling. Both methods return the round
    with the smallest median residual, counting the given scene as a round, so the result is never
    worse by that measure.

    Args:
        detections: person boxes of all cameras and frames, in any order.
        scene: cameras, ground and extent in any units and frame of reference.
        settings: method and constants, as for `localize`; None for `Settings()`, the evidence
            method. `Settings.paper()` selects the paper's procedure.
        rounds: number of rounds; a maximum for the evidence method.
        progress: called as `progress("refinement", done, rounds)`.

    Returns:
        The refined scene, aligned to the frame and scale of the given one as closely as the moved
        cameras allow. Principal points, lens distortion, the extent and unregistered cameras are
        unchanged.

    Raises:
        InvalidInputError: if a detection's camera is not in the rig, a camera is not a pinhole, two
            registered cameras have the same boxes, or `rounds` is negative.
        InsufficientDataError: if fewer than three cameras are registered, they have no confident
            boxes, or no person is seen by three cameras.

    Source:
        Sec. "Camera configuration and ground estimation" of the paper for `Settings.paper()`.
    """
    settings = Settings() if settings is None else settings
    require_instance(detections, Detections, "detections")
    require_scene(scene)
    require_instance(settings, Settings, "settings")
    rounds = as_count(rounds, "rounds", least=0)
    report = as_progress(progress)
    require_pinholes(scene.rig)
    require_known_cameras(detections.camera, scene.rig.camera_count)
    if scene.rig.registered.sum() < CAMERAS:
        raise InsufficientDataError(
            f"Refinement needs people seen by {CAMERAS} cameras, but only "
            f"{int(scene.rig.registered.sum())} of {scene.rig.camera_count} cameras are registered."
        )
    keep = is_confident(detections, settings.confidence)
    keep = keep & scene.rig.registered[detections.camera]
    if not keep.any():
        raise InsufficientDataError(
            f"None of the {len(detections)} boxes is of a registered camera and as confident as "
            f"Settings.confidence ({settings.confidence:g}). Check that they belong to the scene."
        )
    detections = detections[keep]
    require_different_cameras(detections.frame, detections.camera, detections.box)
    if settings.method == "evidence":
        return refine_by_evidence(detections, scene, settings, rounds, report)
    frames = evenly_spread(np.unique(detections.frame), MOST_FRAMES)
    few = detections[np.isin(detections.frame, frames)]
    return _refine_by_paper(few, scene, settings, rounds, report)


def _refine_by_paper(
    detections: Detections,
    scene: Scene,
    settings: Settings,
    rounds: int,
    report: Progress,
) -> Refinement:
    """Refine by the paper's procedure: all rounds, with people from the paper's association."""
    frame = CanonicalFrame.of(scene)
    start = frame.rig(scene.rig)
    observations = observe(detections, start, keep=np.ones(len(detections), bool))
    still = np.zeros((start.camera_count, 7))
    # As in localization, an unweighted pass comes first, which makes all rounds comparable.
    current = _associated(observations, start, still, 1.0, settings)
    current = _associated(observations, start, still, current.ratio, settings)
    if len(current.member) == 0:
        raise InsufficientDataError(
            f"No person is seen by {CAMERAS} cameras at once within the angular "
            f"tolerance, in {len(observations)} detections of {len(observations.frames)} frames: "
            "the rig is too inaccurate to be refined, or the views do not overlap."
        )
    trace = [current]
    for done in range(rounds):
        report("refinement", done, rounds)
        step = _adjusted(observations, current, start)
        current = _associated(observations, start, step, current.ratio, settings)
        if len(current.member) == 0:
            break
        trace.append(current)
    report("refinement", rounds, rounds)
    residuals = np.array([one.residual for one in trace])
    chosen = int(residuals.argmin())
    refined = _scene(frame, scene, trace[chosen]) if chosen else scene
    return Refinement(refined, residuals, chosen, np.array([len(one.member) for one in trace]))


def _associated(
    observations: Observations,
    start: Rig,
    step: Float[np.ndarray, "cam 7"],
    ratio: float,
    settings: Settings,
) -> _Round:
    """Associate people after a step of the cameras, and measure how well their rays meet."""
    rig = moved_rig(start, step)
    rays = cast_rays(observations, rig)
    groups = associate(observations, weigh_rays(observations, rays, ratio, settings), settings)
    if settings.rays.use_ankles:
        ratio = learn_pose_ratio(observations, rays, groups, settings)
    rays = weigh_rays(observations, rays, ratio, settings)
    member = groups[(groups >= 0).sum(1) >= CAMERAS]
    points, residual = triangulate_groups(
        rays, member, settings.triangulation, sigma_theta=settings.rays.sigma_theta
    )
    angle = residual[member >= 0]
    median = float(np.median(angle)) if len(angle) else np.inf
    return _Round(step, rig, rays, member, points.astype(np.float64), median, ratio)


def _adjusted(
    observations: Observations, current: _Round, start: Rig
) -> Float[np.ndarray, "cam 7"]:
    """Adjust the cameras to the people of a round; return their step from the start."""
    member = current.member
    weight = np.where(member >= 0, _pixel_weight(observations, current.ratio)[member], 0.0)
    direction = np.asarray(current.rays.direction, np.float64)[member]
    # Projected rays are the foot pixels without lens distortion.
    pixel = project_directions(current.rig, direction)
    return adjust(pixel, weight, start, current.step, current.points, iterations=STEPS)


def _pixel_weight(observations: Observations, ratio: float) -> Float[np.ndarray, " n"]:
    """Weight of each foot pixel, for box errors proportional to box height.

    The weight of a ray (Eq. w) is lower for small boxes because it concerns lengths on the ground;
    in pixels, small boxes are more exact, down to the resolution of a detector.
    """
    height = observations.kept.height.astype(np.float64)
    median = float(np.median(height))
    weight = median**2 / (height**2 + (RESOLVED * median) ** 2)
    if observations.kept.ankles_confirmed is not None:
        weight = weight * np.where(observations.kept.ankles_confirmed, 1.0, ratio)
    return weight


def _scene(frame: CanonicalFrame, original: Scene, best: _Round) -> Scene:
    """Transform the scene of a round to the world frame of the given scene."""
    R = np.asarray(best.rig.R) @ frame.axes.T
    t = -np.einsum("cij,cj->ci", R, frame.to_world(np.asarray(best.rig.centers)))
    refined = with_registered(original.rig, np.asarray(best.rig.K), R, t)
    height, slope_x, slope_y = ground_under_people(best.points)
    normal = frame.axes @ np.array([-slope_x, -slope_y, 1.0])
    normal /= np.linalg.norm(normal)
    ground = Plane(normal, -normal @ frame.to_world(np.array([0.0, 0.0, height])))
    return replace(original, rig=refined, ground=ground)


def ground_under_people(points: Float[np.ndarray, "person 3"]) -> Float[np.ndarray, "3"]:
    """Fit the ground to people's feet, with the assumed ground z = 0 as a prior.

    Args:
        points: (P, 3) feet in the canonical frame, possibly with outliers.

    Returns:
        (3,) height above the origin and slopes along x and y of `z = height + slope · (x, y)`.
        A slope that the people do not constrain (all on one line) stays near 0.
    """
    design = np.column_stack([np.ones(len(points)), points[:, :2]])
    tie = np.array([CENTER_SD, ROTATION_SD, ROTATION_SD]) ** -2.0
    plane = np.array([np.median(points[:, 2]), 0.0, 0.0])
    for _ in range(GROUND_ITERATIONS):
        residual = np.abs(points[:, 2] - design @ plane)
        noise = max(MEDIAN_TO_DEVIATION * float(np.median(residual)), FLATTEST)
        weight = np.minimum(1.0, HUBER * noise / np.maximum(residual, FLATTEST)) / noise**2
        plane = np.linalg.solve(
            np.einsum("pi,p,pj->ij", design, weight, design) + np.diag(tie),
            np.einsum("pi,p->i", design, weight * points[:, 2]),
        )
    return plane
