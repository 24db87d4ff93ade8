"""Refine a rig by alternating the evidence method and bundle adjustment.

The evidence method selects its most certain people, and the cameras are adjusted to their whole
boxes, feet and heads: upright people on one ground separate focal length, camera height and tilt,
which feet alone cannot do. The adjusted rig makes the people of the next round more certain.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from catfree.calibration._adjusted_cameras import with_registered
from catfree.calibration._bundle_adjustment import CENTER_SD, FOCAL_SD, ROTATION_SD
from catfree.calibration._confident_people import (
    ConfidentPeople,
    confident_people,
    well_seen,
)
from catfree.calibration._refinement import CAMERAS, MOST_FRAMES, STEPS, Refinement
from catfree.calibration.people._radial_lens import ideal_pixels
from catfree.calibration.people.adjustment._people_bundle import (
    BoxMeasurements,
    RigPrior,
    adjust_people_bundle,
)
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, X, of_rig, rotation
from catfree.errors import InsufficientDataError
from catfree.geometry import CanonicalFrame, Similarity, transform_scene
from catfree.geometry._person import edge_deviation, edges_of
from catfree.methods.paper.association import (
    Observations,
    associate_in_two_passes,
    cast_rays,
    observe,
    triangulate_groups,
)
from catfree.settings import CalibrationSettings, Settings
from catfree.types import Detections, Rays, Rig, Scene
from catfree.types._annotations import Progress
from catfree.types._sampling import evenly_spread

SAME_RESIDUAL = 0.01  # relative difference below which residuals count as equal
PATIENCE = 3  # rounds without a smaller residual before the loop ends
FEWEST_LEFT = 0.5  # share of the people at the start; fewer may fit any rig
RUN = 10  # consecutive frames used together, enough to track people


class _Judged(NamedTuple):
    """A scene, the rays of all boxes in it, its confident people and their residual."""

    scene: Scene
    rays: Rays
    people: ConfidentPeople
    residual: float


def refine_by_evidence(
    detections: Detections,
    scene: Scene,
    settings: Settings,
    rounds: int,
    report: Progress,
) -> Refinement:
    """Alternate the evidence method and a bundle adjustment until the residual stops falling.

    Args:
        detections: confident boxes of registered cameras.
        scene: initial cameras and ground; a prior ties the cameras to their poses in it.
        settings: settings of the evidence method and of the bundle adjustment of `calibrate`.
        rounds: maximum number of rounds.
        report: called as `report("refinement", done, rounds)`.

    Returns:
        The scene of the round with the smallest median residual, counting the given scene as a
        round. Its cameras are aligned to the given ones in mean orientation, scale and position.

    Raises:
        InsufficientDataError: if no person is confidently seen by enough cameras.
    """
    detections = detections[in_runs(detections.frame, MOST_FRAMES)]
    observations = observe(detections, scene.rig, keep=np.ones(len(detections), bool))

    def adjusted(people: ConfidentPeople) -> _Judged | None:
        """Adjust the current scene to people and judge it; return None if too few people remain."""
        moved = _adjusted(detections, current.scene, people, scene, settings.calibration)
        try:
            result = _judge(detections, observations, moved, settings)
        except InsufficientDataError:
            return None
        fewest = FEWEST_LEFT * len(trace[0].people.member)
        return result if len(result.people.member) >= fewest else None

    current = _judge(detections, observations, scene, settings)
    if len(current.people.member) == 0:
        raise InsufficientDataError(
            f"No person is confidently seen by {CAMERAS} cameras at once in "
            f"{len(detections)} detections of {len(np.unique(detections.frame))} frames: the rig "
            "is too inaccurate to be refined, or the views do not overlap."
        )
    trace, last_decrease = [current], 0
    use_paper_groups = True  # until the evidence method's people yield the better rig
    for done in range(rounds):
        if done - last_decrease >= PATIENCE:
            break
        report("refinement", done, rounds)
        proposed = adjusted(current.people)
        if use_paper_groups:
            paper_people = _people_of_paper(detections, observations, current, settings)
            alternative = adjusted(paper_people) if len(paper_people.member) else None
            use_paper_groups = alternative is not None and (
                proposed is None or alternative.residual < proposed.residual
            )
            proposed = alternative if use_paper_groups else proposed
        if proposed is None:
            break
        current = proposed
        if current.residual < (1 - SAME_RESIDUAL) * min(one.residual for one in trace):
            last_decrease = done + 1
        trace.append(current)
    report("refinement", rounds, rounds)
    residuals = np.array([one.residual for one in trace])
    chosen = int(residuals.argmin())
    people = np.array([len(one.people.member) for one in trace])
    return Refinement(trace[chosen].scene, residuals, chosen, people)


def in_runs(frame: np.ndarray, most: int) -> Bool[np.ndarray, " n"]:
    """Select the rows of at most `most` frames, in evenly spread runs of consecutive frames.

    People cannot be tracked over isolated frames.
    """
    frames = np.unique(frame)
    if len(frames) <= most:
        return np.ones(len(frame), bool)
    length = min(RUN, most)
    starts = evenly_spread(np.arange(len(frames) - length + 1), most // length)
    return np.isin(frame, frames[np.unique(starts[:, None] + np.arange(length))])


def _judge(
    detections: Detections, observations: Observations, scene: Scene, settings: Settings
) -> _Judged:
    """Find the confident people and the median angle between their foot rays and positions."""
    people = confident_people(detections, scene, settings.evidence)
    rays = cast_rays(observations, CanonicalFrame.of(scene).rig(scene.rig))
    index = np.argsort(observations.row)
    member = np.where(people.member >= 0, index[people.member], -1)
    _, angle = triangulate_groups(
        rays, member, settings.triangulation, sigma_theta=settings.rays.sigma_theta
    )
    residual = float(np.median(angle[member >= 0])) if len(member) else np.inf
    return _Judged(scene, rays, people, residual)


def _people_of_paper(
    detections: Detections, observations: Observations, judged: _Judged, settings: Settings
) -> ConfidentPeople:
    """Group people with the paper's method: by feet within a wide tolerance and by appearance.

    If cameras are off by a degree, the evidence method merges neighboring people and finds a wrong
    rig consistent. Appearance does not depend on the rig.
    """
    groups, _, _ = associate_in_two_passes(observations, judged.rays, settings)
    member = np.where(groups >= 0, observations.row[groups], -1)
    rules = settings.calibration
    sd = edge_deviation(detections.height, rules.relative_sd, rules.pixel_sd)
    return judged.people._replace(
        member=member[well_seen(member)], box_sd=np.repeat(sd[:, None], 3, axis=1)
    )


def _adjusted(
    detections: Detections,
    scene: Scene,
    people: ConfidentPeople,
    original: Scene,
    settings: CalibrationSettings,
) -> Scene:
    """Adjust the scene to the people of a round.

    The adjustment works in meters on the ground z = 0. The usual height of people defines the
    meter, so the result does not depend on the unit of the scene.
    """
    rig = scene.rig
    frame = CanonicalFrame.of(scene)
    unit_in_meters = settings.apparent_height / people.height * frame.extent
    start = _parameters(frame, rig, unit_in_meters)
    # The boxes of a person share their errors over time (shoes, build, detector bias), so together
    # they tell no more about the cameras than a single one.
    deviation = [FOCAL_SD] + [ROTATION_SD] * 3 + [CENTER_SD * unit_in_meters] * 3
    precision = people.repeats * np.array(deviation) ** -2.0
    person, camera = np.nonzero(people.member >= 0)
    row = people.member[person, camera]
    result = adjust_people_bundle(
        BoxMeasurements(person, camera, _ideal_boxes(detections[row], rig), people.box_sd[row]),
        start,
        None,
        RigPrior(
            _parameters(frame, original.rig, unit_in_meters),
            np.broadcast_to(precision, start.shape),
        ),
        settings,
        focal_spread=np.inf,
        iterations=STEPS,
    )
    moved = np.where(np.isfinite(result.parameters), result.parameters, start)
    K = np.array(rig.K, np.float64)
    K[:, :2, :2] *= np.exp(moved[:, LOG_FOCAL] - start[:, LOG_FOCAL])[:, None, None]
    R = rotation(moved) @ frame.axes.T
    t = -np.einsum("cij,cj->ci", R, frame.to_world(moved[:, X:] / unit_in_meters))
    return _aligned_to(original, replace(scene, rig=with_registered(scene.rig, K, R, t)))


def _parameters(
    frame: CanonicalFrame, rig: Rig, unit_in_meters: float
) -> Float[np.ndarray, "cam 7"]:
    """Camera parameters for the bundle adjustment, zero for unregistered cameras."""
    parameters = np.nan_to_num(of_rig(frame.rig(rig)))
    parameters[:, X:] *= unit_in_meters
    return parameters


def _ideal_boxes(detections: Detections, rig: Rig) -> Float[np.ndarray, "n 3"]:
    """Center, top and bottom of boxes for an ideal camera with square pixels and no distortion.

    Offsets from the principal point in units of horizontal pixels.
    """
    box, camera = np.asarray(detections.box, np.float64), detections.camera
    middle = (box[:, 0] + box[:, 2]) / 2
    ends = (ideal_pixels(rig, camera, np.column_stack([middle, box[:, edge]])) for edge in (1, 3))
    return edges_of(*ends)


def _aligned_to(original: Scene, moved: Scene) -> Scene:
    """Rotate, scale and shift a scene so that its cameras as a whole match the given ones."""
    registered = original.rig.registered
    R, to = (np.asarray(s.rig.R, np.float64)[registered] for s in (moved, original))
    center, place = (np.asarray(s.rig.centers, np.float64)[registered] for s in (moved, original))
    turn = Rotation.from_matrix(to.transpose(0, 2, 1) @ R).mean().as_matrix()
    away, apart = (center - center.mean(0)) @ turn.T, place - place.mean(0)
    scale = (away * apart).sum() / (away**2).sum()
    with jax.enable_x64(True):  # single precision resolves half a meter on a map
        similarity = Similarity(scale, turn, place.mean(0) - scale * turn @ center.mean(0))
        moved = transform_scene(similarity, moved)
    rig = moved.rig
    K, R, t = (np.asarray(value, np.float64) for value in (rig.K, rig.R, rig.t))
    return replace(original, rig=with_registered(original.rig, K, R, t), ground=moved.ground)
