"""Bundle adjustment of cameras and people from boxes.

The unknowns are all cameras, their radial distortion where free, and the position and height of
every person in every frame. With one robust weight per box edge, a truncated box loses only its
wrong edge. The prior on person heights fixes the scale, the ground is z = 0, and the heading and
position of one camera fix the rest of the gauge.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.calibration.people._radial_lens import RadialLenses, lens
from catfree.calibration.people.cameras._camera_model import (
    K1,
    LOG_FOCAL,
    PAN,
    ROLL,
    TILT,
    X,
    Z,
    projection,
)
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS, map_ground
from catfree.geometry._buckets import padded, padded_length
from catfree.geometry._least_squares import (
    CAUCHY,
    NormalEquations,
    Residuals,
    SchurLevenbergMarquardt,
    Unknowns,
    cauchy,
    minimize,
    robust,
)
from catfree.geometry._person import box_edges
from catfree.geometry.camera import distort
from catfree.settings import CalibrationSettings

GAUGE_SD = 1e-5  # meters and radians; for the camera that fixes the gauge, and for fixed lenses
STEEPEST_TILT = 1.5  # radians; at a right angle, heading and roll coincide
CAMERA_HEIGHTS = (0.3, 80.0)  # meters; bounds during adjustment
# Most adjustments have one pair of cameras, or the largest number of people that the search uses.
PEOPLE_BLOCK = 1250  # people are padded to this number times a power of 2
CAMERA_BLOCK = 2  # cameras are padded to a multiple of this number


@dataclass(frozen=True)
class BoxMeasurements:
    """Boxes of people seen by several cameras, sorted by person.

    Attributes:
        person: (n,) index of the person, ascending, without gaps.
        camera: (n,) index of the camera.
        box: (n, 3) center, top row, bottom row in pixels from the image center.
        sd: (n, 3) standard deviations in pixels; NaN or infinity for an edge without information.
    """

    person: Int[np.ndarray, " n"]
    camera: Int[np.ndarray, " n"]
    box: Float[np.ndarray, "n 3"]
    sd: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class RigPrior:
    """Gaussian prior on the cameras, which also fixes the gauge.

    Attributes:
        parameters: (C, 7) mean.
        precision: (C, 7) inverse variances; 0 is uninformative.
    """

    parameters: Float[np.ndarray, "cam 7"]
    precision: Float[np.ndarray, "cam 7"]


@dataclass(frozen=True)
class BundleResult:
    """An adjusted rig.

    Attributes:
        parameters: (C, 7) cameras, NaN for cameras without boxes.
        people: (P, 3) ground position and height of people in meters.
        cost: robust cost.
        residual: median absolute standardized residual.
        camera_residual: (C,) the same per camera, NaN for cameras without boxes.
        sightings: (C,) number of boxes used per camera.
        covariance: (7C+1, 7C+1) of cameras and foot offset; zero for cameras without boxes. Boxes
            seem to determine the offset to centimeters, but lens, occlusion and slack bias it by
            more, so it is held fixed with its prior uncertainty.
        k1: (C,) radial distortion of each camera.
        k1_sd: (C,) its standard deviation, 0 where held fixed.
    """

    parameters: Float[np.ndarray, "cam 7"]
    people: Float[np.ndarray, "person 3"]
    cost: float
    residual: float
    camera_residual: Float[np.ndarray, " cam"]
    sightings: Int[np.ndarray, " cam"]
    covariance: Float[np.ndarray, "common common"]
    k1: Float[np.ndarray, " cam"]
    k1_sd: Float[np.ndarray, " cam"]

    def camera_covariance(self, repeats: float) -> Float[np.ndarray, "cam 7 cam 7"]:
        """(C, 7, C, 7) covariance of the cameras.

        Args:
            repeats: boxes of the same person in a camera. Their errors are neither independent nor
                identical: the part of the covariance due to box noise grows by the geometric mean
                of both cases, 1 and `repeats`; that of the foot offset does not.
        """
        by_offset = self.covariance[:, -1] / max(np.sqrt(self.covariance[-1, -1]), 1e-12)
        fixed = np.outer(by_offset, by_offset)
        total = np.sqrt(repeats) * (self.covariance - fixed) + fixed
        count = len(self.parameters)
        return total[:-1, :-1].reshape(count, 7, count, 7)


class _Boxes(NamedTuple):
    """Inputs of the residuals.

    Attributes:
        box: (C, P, 3) measured edges.
        precision: (C, P, 3) inverse standard deviations, 0 where there is no box.
        used: (C,) whether the camera has boxes.
        mean: (C, 8) mean of the prior on the cameras and their k1.
        camera_precision: (C, 8) inverse standard deviations of that prior.
        focal_precision: () inverse standard deviation of log focal lengths from their mean.
        height: () mean of the prior on heights in meters.
        height_precision: (P,) its inverse standard deviation, 0 for absent people.
    """

    box: Float[Array, "cam person 3"]
    precision: Float[Array, "cam person 3"]
    used: Bool[Array, " cam"]
    mean: Float[Array, "cam 8"]
    camera_precision: Float[Array, "cam 8"]
    focal_precision: Float[Array, ""]
    height: Float[Array, ""]
    height_precision: Float[Array, " person"]


def camera_prior(
    cameras: Float[Array, "cam k"],
    mean: Float[Array, "cam k"],
    precision: Float[Array, "cam k"],
) -> Float[Array, " prior"]:
    """Residuals of a prior on cameras; infinite where a camera is impossible.

    Args:
        cameras: (C, 7) cameras, or (C, 8) with their k1.
        mean: mean of the prior, in the shape of `cameras`; angles are compared modulo a full turn.
        precision: inverse standard deviations, in the shape of `cameras`; all 0 for an absent
            camera.
    """
    away = cameras - mean
    turned = (away[:, ROLL : PAN + 1] + jnp.pi) % (2 * jnp.pi) - jnp.pi
    away = away.at[:, ROLL : PAN + 1].set(turned)
    low, high = CAMERA_HEIGHTS
    tilt, z = jnp.abs(cameras[:, TILT]), cameras[:, Z]
    impossible = (tilt > STEEPEST_TILT) | (z < low) | (z > high)
    impossible &= jnp.any(precision > 0, axis=1)
    return jnp.where(impossible[:, None], jnp.inf, away * precision).ravel()


def _problem(
    unknowns: Unknowns, args: tuple[Float[Array, "1"], _Boxes]
) -> tuple[Residuals, Residuals]:
    """Residuals of cameras (C, 8) and people (P, 3), given the foot offset and the boxes."""
    cameras, (foot_offset, boxes) = unknowns.view, args
    log_focal = cameras[:, LOG_FOCAL]
    mean = jnp.mean(log_focal, where=boxes.used)
    apart = jnp.where(boxes.used, (log_focal - mean) * boxes.focal_precision, 0.0)
    residuals = Residuals(
        _box_residuals(unknowns, foot_offset[0], boxes)[..., None],
        jnp.append(camera_prior(cameras, boxes.mean, boxes.camera_precision), apart),
        ((unknowns.block[:, 2] - boxes.height) * boxes.height_precision)[:, None],
    )
    return robust(residuals, partial(cauchy, width=CAUCHY))


def _box_residuals(
    unknowns: Unknowns, foot_offset: Float[Array, ""], boxes: _Boxes
) -> Float[Array, "cam person 3"]:
    """Standardized residuals of the boxes, 0 where there is no box."""

    def edges(camera: Float[Array, "8"], person: Float[Array, "3"]) -> Float[Array, "3"]:
        pose, focal = camera[:K1], jnp.exp(camera[LOG_FOCAL])
        bent = lambda pixel: focal * distort(pixel / focal, lens(camera[K1]))  # noqa: E731
        return box_edges(projection(pose), person, pose[X:Z], foot_offset, bent)

    of_camera = jax.vmap(edges, (None, 0))
    box = jax.vmap(of_camera, (0, None))(unknowns.view, unknowns.block)
    return (box - boxes.box) * boxes.precision


@jax.jit
def _solve(
    start: Unknowns, foot_offset: Array, foot_offset_sd: Array, boxes: _Boxes, most_steps: Array
) -> tuple[Unknowns, Array, Array, Array]:
    """Solve; return unknowns, cost, covariance of cameras and foot offset, and residuals."""
    args = foot_offset[None], boxes
    solver = SchurLevenbergMarquardt(most_steps=most_steps)
    solution = minimize(_problem, start, args, solver)
    equations: NormalEquations = solution.stats["equations"]
    covariance = equations.covariance(jnp.square(foot_offset_sd)[None, None])
    residual = _box_residuals(solution.value, foot_offset, boxes)
    return solution.value, solution.stats["cost"], covariance, residual


def adjust_people_bundle(
    measurements: BoxMeasurements,
    parameters: Float[np.ndarray, "cam 7"],
    people: Float[np.ndarray, "person 3"] | None,
    known: RigPrior,
    settings: CalibrationSettings,
    *,
    focal_spread: float,
    iterations: int,
    k1: Float[np.ndarray, " cam"] | None = None,
) -> BundleResult:
    """Adjust cameras and people together.

    Args:
        measurements: the boxes.
        parameters: (C, 7) initial cameras.
        people: (P, 3) initial ground positions and heights in meters; from single views if None.
        known: prior on the cameras, such as `weak_prior`.
        settings: constants.
        focal_spread: standard deviation of log focal lengths from their mean; infinity if they are
            unrelated.
        iterations: maximum number of steps.
        k1: (C,) initial radial distortion of each camera, also adjusted; None for ideal lenses.
    """
    data = replace(measurements, sd=np.nan_to_num(measurements.sd, nan=np.inf, posinf=np.inf))
    if people is None:
        people = _people_of_views(data, parameters, k1, settings)
    count, cameras = len(people), len(parameters)
    sightings = np.bincount(data.camera, minlength=cameras)
    used = sightings > 0
    boxes, precision = (np.zeros((cameras, count, 3)) for _ in range(2))
    boxes[data.camera, data.person], precision[data.camera, data.person] = data.box, 1 / data.sd
    P, C = padded_length(count, PEOPLE_BLOCK, 2), cameras + -cameras % CAMERA_BLOCK
    bent, lens_sd = (np.zeros(cameras), GAUGE_SD) if k1 is None else (k1, settings.distortion_sd)
    shown = np.where(used[:, None], np.column_stack([parameters, bent]), 0.0)
    camera_precision = np.column_stack([np.sqrt(known.precision), np.full(cameras, 1 / lens_sd)])
    with jax.enable_x64(True):
        solution, cost, covariance, residual = jax.tree.map(
            np.asarray,
            _solve(
                Unknowns(padded(shown, C), padded(people, P)),
                jnp.asarray(settings.foot_offset),
                jnp.asarray(settings.foot_offset_sd),
                _Boxes(
                    box=padded(boxes, C, P),
                    precision=padded(precision, C, P),
                    used=padded(used, C),
                    mean=padded(np.column_stack([known.parameters, np.zeros(cameras)]), C),
                    camera_precision=padded(camera_precision * used[:, None], C),
                    focal_precision=jnp.asarray(1 / focal_spread),
                    height=jnp.asarray(settings.apparent_height),
                    height_precision=padded(np.full(count, 1 / settings.person_height_sd), P),
                ),
                jnp.asarray(iterations, jnp.int32),
            ),
        )
    kept = np.append(np.repeat(used, K1), True)
    index = np.append(np.flatnonzero(np.arange(8 * cameras) % 8 != K1), len(covariance) - 1)
    view = solution.view[:cameras]
    residual = -residual[data.camera, data.person]
    k1_sd = np.sqrt(np.diag(covariance)[K1 : 8 * cameras : 8])
    return BundleResult(
        np.where(used[:, None], view[:, :K1], np.nan),
        solution.block[:count],
        float(cost),
        _median_size(residual),
        np.array([_median_size(residual[data.camera == c]) for c in range(cameras)]),
        sightings,
        covariance[np.ix_(index, index)] * np.outer(kept, kept),
        bent if k1 is None else np.where(used, view[:, K1], bent),
        np.where(used & (k1 is not None), k1_sd, 0.0),
    )


def _people_of_views(
    measurements: BoxMeasurements,
    parameters: Float[np.ndarray, "cam 7"],
    k1: Float[np.ndarray, " cam"] | None,
    settings: CalibrationSettings,
) -> Float[np.ndarray, "person 3"]:
    """(P, 3) ground position, averaged over single views, and usual height of each person."""
    boxes = measurements.box
    if k1 is not None:
        lenses = RadialLenses(np.exp(parameters[:, LOG_FOCAL]), k1)
        boxes = lenses.straightened(measurements.camera, boxes)
    count = int(measurements.person.max()) + 1
    total, weights = np.zeros((count, 2)), np.full(count, 1e-9)
    for camera in np.unique(measurements.camera):
        mine = measurements.camera == camera
        person, box, sd = measurements.person[mine], boxes[mine], measurements.sd[mine]
        ground_map = map_ground(
            parameters[camera],
            box[None],
            np.minimum(sd.mean(1), 0.2 * (box[:, 2] - box[:, 1]))[None],
            np.ones((1, len(box)), bool),
            settings,
            range_tolerance=RANGE_ERRORS[-1],
        )
        weight = ground_map.valid[0] / ground_map.covariance[0].trace(axis1=1, axis2=2)
        np.add.at(total, person, weight[:, None] * ground_map.xy[0])
        np.add.at(weights, person, weight)
    return np.column_stack([total / weights[:, None], np.full(count, settings.apparent_height)])


def weak_prior(
    camera: Int[np.ndarray, " n"],
    parameters: Float[np.ndarray, "cam 7"],
    log_focal: Float[np.ndarray, " cam"],
    settings: CalibrationSettings,
) -> RigPrior:
    """Prior on focal lengths and rolls that fixes the camera with most boxes on the ground.

    Args:
        camera: (n,) camera of each box.
        parameters: (C, 7) initial cameras.
        log_focal: (C,) means of the log focal lengths.
        settings: constants.
    """
    anchor = int(np.argmax(np.bincount(camera)))
    mean, precision = np.zeros(parameters.shape), np.zeros(parameters.shape)
    mean[:, LOG_FOCAL], mean[anchor, PAN:Z] = log_focal, parameters[anchor, PAN:Z]
    precision[:, LOG_FOCAL], precision[:, ROLL] = settings.focal_log_sd**-2, settings.roll_sd**-2
    precision[anchor, PAN:Z] = GAUGE_SD**-2
    return RigPrior(mean, precision)


def _median_size(residual: Float[np.ndarray, "n 3"]) -> float:
    return float(np.median(np.abs(residual))) if residual.size else np.nan
