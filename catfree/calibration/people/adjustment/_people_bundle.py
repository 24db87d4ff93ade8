"""Bundle adjustment of cameras and people from boxes, with the people eliminated (Schur).

The unknowns are all cameras, the common foot offset, and the position and height of every person in
every frame. With one robust weight per box edge, a truncated box loses only its wrong edge. The
prior on person heights fixes the scale, the ground is z = 0, and the heading and position of one
camera fix the rest of the gauge.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.people.adjustment._box_measurements import BoxMeasurements, KnownCameras
from catfree.calibration.people.adjustment._normal_equations import NormalEquations
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, X, Z
from catfree.settings import CalibrationSettings


@dataclass(frozen=True)
class BundleResult:
    """An adjusted rig.

    Attributes:
        parameters: (C, 7) cameras, NaN for cameras without boxes.
        foot_offset: meters.
        xy: (P, 2) people in meters.
        height: (P,) their heights in meters.
        cost: robust cost.
        residual: median absolute standardized residual.
        camera_residual: (C,) the same per camera, NaN for cameras without boxes.
        sightings: (C,) number of boxes used per camera.
        covariance: (7C+1, 7C+1) of cameras and foot offset; zero for fixed parameters.
    """

    parameters: Float[np.ndarray, "cam 7"]
    foot_offset: float
    xy: Float[np.ndarray, "person 2"]
    height: Float[np.ndarray, " person"]
    cost: float
    residual: float
    camera_residual: Float[np.ndarray, " cam"]
    sightings: Int[np.ndarray, " cam"]
    covariance: Float[np.ndarray, "common common"]

    @property
    def focal_deviation(self) -> Float[np.ndarray, " cam"]:
        """(C,) relative standard deviation of each focal length, 0 for cameras without boxes."""
        return np.sqrt(np.diag(self.covariance)[LOG_FOCAL:-1:7])

    @property
    def center_covariance(self) -> Float[np.ndarray, "cam 3 3"]:
        """(C, 3, 3) covariance of each camera center in square meters."""
        index = 7 * np.arange(len(self.parameters))[:, None] + np.arange(X, Z + 1)
        return self.covariance[index[:, :, None], index[:, None, :]]


def adjust(
    measurements: BoxMeasurements,
    parameters: Float[np.ndarray, "cam 7"],
    xy: Float[np.ndarray, "person 2"],
    height: Float[np.ndarray, " person"],
    foot_offset: float,
    log_focal_prior: Float[np.ndarray, " cam"],
    settings: CalibrationSettings,
    *,
    shared_focal: bool,
    iterations: int = 15,
    known: KnownCameras | None = None,
) -> BundleResult:
    """Adjust cameras, foot offset and people together.

    Args:
        measurements: the boxes.
        parameters: (C, 7) initial cameras.
        xy: (P, 2) initial people in meters.
        height: (P,) their initial heights in meters.
        foot_offset: initial foot offset in meters.
        log_focal_prior: (C,) mean of the weak prior on log focal length.
        settings: constants.
        shared_focal: whether all cameras have one focal length.
        iterations: maximum number of steps.
        known: prior on the cameras; if None, heading and position of one camera are fixed.
    """
    problem = NormalEquations(
        measurements, len(parameters), len(xy), log_focal_prior, settings, shared_focal, known
    )
    state = (parameters.copy(), foot_offset, xy.copy(), height.copy())
    linear = problem.linearize(*state)
    damping = 1e-3
    for _ in range(iterations):
        trial = problem.step(linear, *state, damping)
        if trial is None:
            damping *= 10
            continue
        proposed = problem.linearize(*trial)
        if proposed.cost < linear.cost:
            converged = linear.cost - proposed.cost < 1e-4 * linear.cost
            state, linear = trial, proposed
            damping = max(damping / 5, 1e-8)
            if converged:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    out = np.where(problem.used[:, None], state[0], np.nan)
    return BundleResult(
        out,
        state[1],
        state[2],
        state[3],
        linear.cost,
        float(np.median(np.abs(linear.residual))) if linear.residual.size else 0.0,
        np.array([_median_size(linear.residual[rows]) for rows in problem.rows]),
        np.array([len(rows) for rows in problem.rows]),
        problem.covariance(linear, *state),
    )


def focal_lengths_differ(
    shared: BundleResult, separate: BundleResult, settings: CalibrationSettings
) -> bool:
    """Whether separate focal lengths reduce the cost per person enough to be accepted.

    Args:
        shared: the rig adjusted with one focal length for all cameras.
        separate: the rig adjusted with one focal length per camera.
        settings: constants; see `free_focal_gain`.
    """
    costs = [result.cost / max(len(result.xy), 1) for result in (shared, separate)]
    return costs[1] <= (1 - settings.free_focal_gain) * costs[0]


def _median_size(residual: Float[np.ndarray, "n 3"]) -> float:
    return float(np.median(np.abs(residual))) if residual.size else np.nan
