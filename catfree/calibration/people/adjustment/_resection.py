"""Refine one camera against people with known positions.

A placement from voting has the errors of a single view (a degree, a tenth of the range), which make
correct placements look wrong. Every candidate is therefore refined before it is judged.
"""

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.adjustment._normal_equations import CAUCHY
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, ROLL, TILT, Z, box_jacobian
from catfree.calibration.people.cameras._ground_map import GroundMap, map_ground
from catfree.calibration.people.matching._mutual_nearest import mutual_nearest, squared_distances
from catfree.settings import CalibrationSettings

TOLERANCES = (0.10, 0.06, 0.03)  # fraction of the range, decreasing as the camera converges
PASSES = 2
FEWEST_MATCHES = 6


def resect(
    grid: BoxGrid,
    camera: int,
    start: Float[np.ndarray, "7"],
    people: GroundMap,
    settings: CalibrationSettings,
    *,
    foot_offset: float,
    log_focal: tuple[float, float],
) -> Float[np.ndarray, "7"] | None:
    """Refine one camera against a fixed map of people.

    Args:
        grid: all boxes.
        camera: index of the camera.
        start: (7,) its initial parameters in world coordinates.
        people: map of the other cameras, same frames.
        settings: constants.
        foot_offset: meters by which the visible foot is closer to the camera.
        log_focal: mean and standard deviation of the prior on log focal length.

    Returns:
        (7,) refined parameters, or None if it diverges or matches too few people.
    """
    parameters = start
    for tolerance in TOLERANCES:
        for _ in range(PASSES):
            own_map = map_ground(
                parameters,
                grid.u[camera],
                grid.top[camera],
                grid.bottom[camera],
                grid.sd[camera],
                grid.valid[camera],
                settings,
                foot_offset=foot_offset,
                range_tolerance=tolerance,
            )
            time, slot, partner = mutual_nearest(
                *squared_distances(own_map, people), settings.match_gate
            )
            if len(time) < FEWEST_MATCHES:
                return None
            measured = np.stack(
                [
                    grid.u[camera, time, slot],
                    grid.top[camera, time, slot],
                    grid.bottom[camera, time, slot],
                ],
                -1,
            )
            spread = np.zeros((len(time), 3, 3))
            spread[:, :2, :2] = people.covariance[time, partner]
            spread[:, 2, 2] = people.height_sd[time, partner] ** 2
            parameters = fit_camera(
                parameters,
                measured,
                grid.sd[camera, time, slot],
                people.xy[time, partner],
                people.height[time, partner],
                spread,
                settings,
                foot_offset=foot_offset,
                log_focal=log_focal,
            )
            if not (np.isfinite(parameters).all() and 0.5 < parameters[Z] < 60):
                return None
    return parameters


def fit_camera(
    start: Float[np.ndarray, "7"],
    measured: Float[np.ndarray, "n 3"],
    sd: Float[np.ndarray, " n"],
    xy: Float[np.ndarray, "n 2"],
    height: Float[np.ndarray, " n"],
    covariance: Float[np.ndarray, "n 3 3"],
    settings: CalibrationSettings,
    *,
    foot_offset: float,
    log_focal: tuple[float, float],
    iterations: int = 8,
) -> Float[np.ndarray, "7"]:
    """Fit the seven parameters of a camera by Levenberg-Marquardt with a Cauchy loss.

    Args:
        start: (7,) initial parameters.
        measured: (n, 3) box center, top row, bottom row in pixels from the image center.
        sd: (n,) standard deviations of the edges in pixels.
        xy: (n, 2) people in meters.
        height: (n,) their heights in meters.
        covariance: (n, 3, 3) of (x, y, height) in square meters.
        settings: constants.
        foot_offset: meters by which the visible foot is closer to the camera.
        log_focal: mean and standard deviation of the prior on log focal length.
        iterations: maximum number of steps.

    Returns:
        (7,) the parameters with the smallest cost.
    """
    mean = np.zeros(7)
    mean[LOG_FOCAL] = log_focal[0]
    precision = np.zeros(7)
    precision[LOG_FOCAL], precision[ROLL] = log_focal[1] ** -2, settings.roll_sd**-2
    parameters, damping = start, 1e-3
    box, by_camera, by_person, _ = box_jacobian(
        np.broadcast_to(parameters, (len(xy), 7)), xy, height, foot_offset
    )
    # The uncertainty of the people adds to the noise.
    noise = np.sqrt(
        sd[:, None] ** 2 + np.einsum("nij,njk,nik->ni", by_person, covariance, by_person)
    )

    def cost_of(box: Float[np.ndarray, "n 3"], parameters: Float[np.ndarray, "7"]) -> float:
        residual = (measured - box) / noise / CAUCHY
        prior = float(precision @ (parameters - mean) ** 2)
        return CAUCHY**2 * float(np.log1p(residual**2).sum()) + prior

    cost = cost_of(box, parameters)
    for _ in range(iterations):
        residual = (measured - box) / noise
        weight = 1 / (1 + (residual / CAUCHY) ** 2)
        design = by_camera / noise[..., None]
        normal = np.einsum("nri,nr,nrj->ij", design, weight, design) + np.diag(precision)
        target = np.einsum("nri,nr,nr->i", design, weight, residual)
        target -= precision * (parameters - mean)
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), target)
        trial = parameters + step
        if abs(trial[TILT]) > 1.5 or trial[Z] < 0.3 or abs(step[LOG_FOCAL]) > 1:
            damping *= 10
            continue
        proposed = box_jacobian(np.broadcast_to(trial, (len(xy), 7)), xy, height, foot_offset)
        new_cost = cost_of(proposed[0], trial)
        if new_cost < cost:
            converged = cost - new_cost < 1e-4 * cost
            parameters, cost = trial, new_cost
            box, by_camera = proposed[:2]
            damping = max(damping / 5, 1e-7)
            if converged:
                break
        else:
            damping *= 10
    return parameters
