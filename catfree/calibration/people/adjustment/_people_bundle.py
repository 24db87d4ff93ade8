"""Bundle adjustment of cameras and people from boxes, with the people eliminated (Schur).

Unknown are all cameras, the common foot offset, and the place and height of every person in every
frame. A robust weight per box edge lets a truncated box lose only the edge that is wrong. Scale
comes from the prior on person heights, the ground is z = 0, and the heading and place of one camera
fix the rest of the gauge.
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
        parameters: (C, 7) cameras, NaN where no box was given.
        foot_offset: metres.
        xy: (P, 2) people in metres.
        height: (P,) their heights in metres.
        cost: robust cost.
        residual: median absolute standardised residual.
        camera_residual: (C,) the same of each camera's boxes, NaN where no box was given.
        sightings: (C,) boxes of each camera that took part.
        covariance: (7C+1, 7C+1) of cameras and foot offset; zero for what is held.
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
        """(C,) relative standard deviation of each focal length, 0 of cameras without boxes."""
        return np.sqrt(np.diag(self.covariance)[LOG_FOCAL:-1:7])

    @property
    def center_covariance(self) -> Float[np.ndarray, "cam 3 3"]:
        """(C, 3, 3) covariance of each camera centre in square metres."""
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
        parameters: (C, 7) start of the cameras.
        xy: (P, 2) start of the people in metres.
        height: (P,) start of their heights in metres.
        foot_offset: start of the foot offset in metres.
        log_focal_prior: (C,) middle of the weak prior on log focal length.
        settings: constants.
        shared_focal: whether all cameras have one focal length.
        iterations: at most this many steps.
        known: what is known of the cameras; without it heading and place of one camera are held.
    """
    problem = NormalEquations(
        measurements, len(parameters), len(xy), log_focal_prior, settings, shared_focal, known
    )
    state = (parameters.copy(), foot_offset, xy.copy(), height.copy())
    linear = problem.linearise(*state)
    damping = 1e-3
    for _ in range(iterations):
        trial = problem.step(linear, *state, damping)
        if trial is None:
            damping *= 10
            continue
        derivatives = problem.linearise(*trial)
        if derivatives.cost < linear.cost:
            done = linear.cost - derivatives.cost < 1e-4 * linear.cost
            state, linear = trial, derivatives
            damping = max(damping / 5, 1e-8)
            if done:
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
    together: BundleResult, apart: BundleResult, settings: CalibrationSettings
) -> bool:
    """Whether a focal length for each camera saves enough of the cost per person to be believed.

    Args:
        together: the rig adjusted with one focal length.
        apart: the same with one each.
        settings: constants; see `free_focal_gain`.
    """
    costs = [found.cost / max(len(found.xy), 1) for found in (together, apart)]
    return costs[1] <= (1 - settings.free_focal_gain) * costs[0]


def _median_size(residual: Float[np.ndarray, "n 3"]) -> float:
    return float(np.median(np.abs(residual))) if residual.size else np.nan
