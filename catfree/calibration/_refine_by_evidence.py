"""Refine a rig in a loop with the evidence method: better people, better rig, better people.

The evidence method names the people it is surest of. Their whole boxes, feet and heads, move the
cameras: that people stand upright on one ground tells focal length, height and tilt apart, which
feet alone leave open. The moved rig makes the next round's people surer.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from catfree.calibration._bundle_adjustment import CameraTie
from catfree.calibration._confident_people import SurePeople, sure_people
from catfree.calibration._refinement import SAME_RESIDUAL, Refinement, RefinementSettings
from catfree.calibration.people._correspondences import adjust_groups
from catfree.calibration.people.adjustment._box_measurements import BoxMeasurements, KnownCameras
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, X, from_matrices, rotation
from catfree.errors import InsufficientDataError
from catfree.geometry import CanonicalFrame, Similarity, transform_scene
from catfree.methods.evidence.observe._boxes import undistort
from catfree.methods.paper.association import (
    Observations,
    associate_in_two_passes,
    cast_rays,
    observe,
    triangulate_groups,
)
from catfree.settings import CalibrationSettings, Settings
from catfree.types import Detections, Rig, Scene
from catfree.types._progress import Progress
from catfree.types._sampling import evenly_spread

PATIENCE = 3  # rounds without a smaller residual: it has stopped falling
FEWEST_LEFT = 0.5  # of the people at the start: the few who are left may fit any rig
RUN = 10  # consecutive frames that take part together: enough to see tracks


class _Judged(NamedTuple):
    """A scene, the people whom the evidence method is sure of in it, and their residual."""

    scene: Scene
    people: SurePeople
    residual: float


def refine_by_evidence(
    detections: Detections,
    scene: Scene,
    settings: Settings,
    rounds: int,
    refinement: RefinementSettings,
    report: Progress,
) -> Refinement:
    """Alternate the evidence method and a bundle adjustment until the residual stops falling.

    Args:
        detections: the boxes that take part, all of registered cameras.
        scene: cameras and ground to begin with; they are also what the cameras are tied to.
        settings: of the evidence method and of the bundle adjustment of `calibrate`.
        rounds: at most so many.
        refinement: constants of the refinement.
        report: called as `report("refinement", done, rounds)`.

    Returns:
        The scene of the round with the smallest median residual, the given one included. Its
        cameras are as a whole where the given ones were, in the mean of their orientations, in
        scale and in place.

    Raises:
        InsufficientDataError: if nobody is seen by enough cameras beyond doubt.
    """
    detections = detections[in_runs(detections.frame, refinement.maximum_frames)]

    def judged(candidate: Scene) -> _Judged | None:
        """The scene judged, or None where the rig fell apart."""
        try:
            found = _judge(detections, candidate, settings, refinement.cameras)
        except InsufficientDataError:
            return None
        return found if len(found.people.member) >= FEWEST_LEFT * people[0] else None

    def adjusted(at: _Judged, people: SurePeople) -> Scene:
        return _adjusted(detections, at.scene, people, scene, settings.calibration, refinement)

    current = _judge(detections, scene, settings, refinement.cameras)
    if len(current.people.member) == 0:
        raise InsufficientDataError(
            f"No person is seen by {refinement.cameras} cameras at once beyond doubt, in "
            f"{len(detections)} detections of {len(np.unique(detections.frame))} frames. The rig "
            "is too far off to be refined, or the views do not overlap."
        )
    best, chosen, fell = current, 0, 0
    residuals, people = [current.residual], [len(current.people.member)]
    astray = True  # until the evidence method's own people lead to the better rig
    for done in range(rounds):
        if done - fell >= PATIENCE:
            break
        report("refinement", done, rounds)
        found = judged(adjusted(current, current.people))
        if astray:
            alike = _alike_people(detections, current, settings, refinement.cameras)
            other = judged(adjusted(current, alike)) if len(alike.member) else None
            astray = other is not None and (found is None or other.residual < found.residual)
            found = other if astray else found
        if found is None:
            break
        current = found
        residuals.append(current.residual)
        people.append(len(current.people.member))
        if current.residual < (1 - SAME_RESIDUAL) * best.residual:
            fell = done + 1
        if current.residual < best.residual:
            best, chosen = current, done + 1
    report("refinement", rounds, rounds)
    refined = best.scene
    if not refinement.refit_ground:
        refined = Scene(refined.rig, scene.ground, scene.extent, scene.metric)
    return Refinement(refined, np.array(residuals), chosen, np.array(people))


def in_runs(frame: np.ndarray, most: int) -> Bool[np.ndarray, " n"]:
    """Which rows are in at most `most` frames: runs of consecutive ones, evenly spread.

    In single frames far apart nobody could be tracked.
    """
    frames = np.unique(frame)
    if len(frames) <= most:
        return np.ones(len(frame), bool)
    length = min(RUN, most)
    starts = evenly_spread(np.arange(len(frames) - length + 1), most // length)
    return np.isin(frame, frames[np.unique(starts[:, None] + np.arange(length))])


def _judge(detections: Detections, scene: Scene, settings: Settings, fewest: int) -> _Judged:
    """Who is there for sure, and the median angle between foot rays and where they meet."""
    people = sure_people(detections, scene, settings.evidence, fewest_views=fewest)
    rig, observations = _observed(detections, scene)
    index = np.empty(len(detections), int)
    index[observations.row] = np.arange(len(detections))
    member = np.where(people.member >= 0, index[people.member], -1)
    _, angle = triangulate_groups(
        cast_rays(observations, rig),
        member,
        settings.triangulation,
        sigma_theta=settings.rays.sigma_theta,
    )
    residual = float(np.median(angle[member >= 0])) if len(member) else np.inf
    return _Judged(scene, people, residual)


def _observed(detections: Detections, scene: Scene) -> tuple[Rig, Observations]:
    """The rig in the canonical frame, and all detections in canonical order."""
    rig = CanonicalFrame.of(scene).rig(scene.rig)
    return rig, observe(detections, rig, keep=np.ones(len(detections), bool))


def _alike_people(
    detections: Detections, judged: _Judged, settings: Settings, fewest: int
) -> SurePeople:
    """The paper's groups: by feet within a wide tolerance and by looks, whatever the heights.

    Where cameras are off by a degree the evidence method takes neighbours for one person: a wrong
    rig seems consistent to it. Looks do not depend on the rig.
    """
    rig, observations = _observed(detections, judged.scene)
    groups, _, _ = associate_in_two_passes(observations, cast_rays(observations, rig), settings)
    member = np.where(groups.member >= 0, observations.row[groups.member], -1)
    cameras = int((member >= 0).any(0).sum())
    fewest = max(fewest, -(-cameras // 2))
    sd = settings.calibration.edge_deviation(detections.height)
    return SurePeople(
        member[(member >= 0).sum(1) >= fewest],
        np.repeat(sd[:, None], 3, axis=1),
        judged.people.height,
        judged.people.repeats,
    )


def _adjusted(
    detections: Detections,
    scene: Scene,
    people: SurePeople,
    given: Scene,
    settings: CalibrationSettings,
    refinement: RefinementSettings,
) -> Scene:
    """The scene after a bundle adjustment with the people of a round.

    The adjustment works in metres on the ground z = 0. People of the usual height say how long a
    metre is, so that no unit of the scene matters.
    """
    rig = scene.rig
    frame = CanonicalFrame.of(scene)
    metres = settings.apparent_height / people.height * frame.extent
    start = _parameters(frame, rig, metres)
    person, camera = np.nonzero(people.member >= 0)
    row = people.member[person, camera]
    found = adjust_groups(
        BoxMeasurements(person, camera, _ideal_boxes(detections[row], rig), people.box_sd[row]),
        start,
        settings.foot_offset,
        start[:, LOG_FOCAL],
        # The given rig says more about focal lengths and rolls than these weak priors.
        replace(settings, focal_log_sd=np.inf, roll_sd=np.inf),
        shared_focal=False,
        iterations=refinement.iterations,
        known=KnownCameras(
            _parameters(frame, given.rig, metres),
            # A person's boxes err alike at all times (shoes, build, the detector's ways), so that
            # all of them together know no more of the cameras than one.
            max(people.repeats, 1.0) * _precision(refinement.tie, metres),
        ),
    )
    moved = np.where(np.isfinite(found.parameters), found.parameters, start)
    K = np.array(rig.K, np.float64)
    K[:, :2, :2] *= np.exp(moved[:, LOG_FOCAL] - start[:, LOG_FOCAL])[:, None, None]
    R = rotation(moved) @ frame.axes.T
    t = -np.einsum("cij,cj->ci", R, frame.to_world(moved[:, X:] / metres))
    return _in_place_of(given, _with_cameras(scene, K, R, t))


def _parameters(frame: CanonicalFrame, rig: Rig, metres: float) -> Float[np.ndarray, "cam 7"]:
    """The cameras as the bundle adjustment takes them, zero where they are not registered."""
    upright = frame.rig(rig)
    K, R, t = (np.asarray(value, np.float64) for value in (upright.K, upright.R, upright.t))
    known = rig.registered[:, None, None]
    return from_matrices(
        np.where(known, K, np.eye(3)),
        np.where(known, R, np.eye(3)),
        np.where(known[..., 0], t * metres, 0.0),
    )


def _precision(tie: CameraTie, metres: float) -> Float[np.ndarray, "7"]:
    """Inverse variances in the order of the bundle adjustment's parameters."""
    deviation = [tie.log_focal] + [tie.rotation] * 3 + [tie.center * metres] * 3
    return np.array(deviation) ** -2.0


def _ideal_boxes(detections: Detections, rig: Rig) -> Float[np.ndarray, "n 3"]:
    """Centre, top and bottom of boxes as a camera with square pixels and no lens sees them.

    In pixels of the horizontal focal length from the principal point.
    """
    box, camera = np.asarray(detections.box, np.float64), detections.camera
    K = np.asarray(rig.K, np.float64)[camera]
    middle = (box[:, 0] + box[:, 2]) / 2
    columns, rows = [], []
    for row in (box[:, 1], box[:, 3]):
        pixel = undistort(rig, camera, np.stack([middle, row], -1))
        plane = np.linalg.solve(K, np.column_stack([pixel, np.ones(len(row))])[..., None])
        columns.append(K[:, 0, 0] * plane[:, 0, 0])
        rows.append(K[:, 0, 0] * plane[:, 1, 0])
    return np.stack([(columns[0] + columns[1]) / 2, *rows], -1)


def _in_place_of(given: Scene, moved: Scene) -> Scene:
    """A scene turned, scaled and shifted so that its cameras as a whole are the given ones."""
    known = given.rig.registered
    R, to = (np.asarray(s.rig.R, np.float64)[known] for s in (moved, given))
    center, place = (np.asarray(s.rig.centers, np.float64)[known] for s in (moved, given))
    turn = Rotation.from_matrix(to.transpose(0, 2, 1) @ R).mean().as_matrix()
    away, apart = (center - center.mean(0)) @ turn.T, place - place.mean(0)
    scale = (away * apart).sum() / (away**2).sum()
    similarity = Similarity(scale, turn, place.mean(0) - scale * turn @ center.mean(0))
    moved = transform_scene(similarity, moved)
    rig = moved.rig
    K, R, t = (np.asarray(value, np.float64) for value in (rig.K, rig.R, rig.t))
    placed = Scene(rig, moved.ground, given.extent, given.metric)
    return _with_cameras(placed, K, R, t, like=given.rig)


def _with_cameras(
    scene: Scene, K: np.ndarray, R: np.ndarray, t: np.ndarray, like: Rig | None = None
) -> Scene:
    """The scene with other cameras; those that are not registered stay as in `like`."""
    like = scene.rig if like is None else like
    known = like.registered[:, None, None]
    rig = Rig(
        np.where(known, K, np.asarray(like.K, np.float64)),
        np.where(known, R, np.asarray(like.R, np.float64)),
        np.where(known[..., 0], t, np.asarray(like.t, np.float64)),
        like.image_size,
        like.distortion,
        like.registered,
    )
    return Scene(rig, scene.ground, scene.extent, scene.metric)
