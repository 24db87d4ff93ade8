"""Uncertainty of the shape and the metric scale of a rig registered from pedestrians."""

import numpy as np
from jaxtyping import Bool, Float

from catfree.calibration.people.cameras._camera_model import X
from catfree.settings import CalibrationSettings


def scale_deviation(
    parameters: Float[np.ndarray, "cam 7"],
    covariance: Float[np.ndarray, "cam 7 cam 7"],
    known: Bool[np.ndarray, " cam"],
) -> float:
    """Relative standard deviation of the scale of a similarity fitted to the camera centers.

    Args:
        parameters: (C, 7) cameras as in `_camera_model`.
        covariance: (C, 7, C, 7) of the cameras.
        known: (C,) cameras to use, at least two.
    """
    cameras = np.flatnonzero(known)
    spread = parameters[cameras, X:] - parameters[cameras, X:].mean(0)
    slope = np.zeros(parameters.shape)
    slope[cameras, X:] = spread / max(float((spread**2).sum()), 1e-12)
    variance = float(np.einsum("ci,cidj,dj->", slope, covariance, slope))
    return float(np.sqrt(max(variance, 0.0)))


def shape_deviation(
    parameters: Float[np.ndarray, "cam 7"],
    covariance: Float[np.ndarray, "cam 7 cam 7"],
    known: Bool[np.ndarray, " cam"],
) -> float | None:
    """Root mean square deviation of camera centers after the best-fitting similarity.

    Args:
        parameters: (C, 7) cameras as in `_camera_model`.
        covariance: (C, 7, C, 7) of the cameras.
        known: (C,) cameras to use.

    Returns:
        Meters; None if a covariance is unknown (NaN), or with two cameras, whose centers any
        similarity can match.
    """
    centers = parameters[known, X:]
    covariance = covariance[known][:, X:, known][..., X:]
    count = len(centers)
    if count < 3 or not np.isfinite(covariance).all():
        return None
    offset = centers - centers.mean(0)
    turns = np.cross(np.eye(3)[None], offset[:, None])  # small rotations about the three axes
    moves = np.concatenate(
        [np.broadcast_to(np.eye(3), (count, 3, 3)), turns, offset[:, None]], axis=1
    )
    basis, length, _ = np.linalg.svd(
        np.moveaxis(moves, 1, 2).reshape(3 * count, -1), full_matrices=False
    )
    basis = basis[:, length > 1e-9 * length[0]]
    total = covariance.reshape(3 * count, 3 * count)
    variance = np.trace(total) - np.trace(basis.T @ total @ basis)
    return float(np.sqrt(max(variance, 0.0) / count))


def crowd_deviation(people_at_a_time: float, settings: CalibrationSettings) -> float:
    """Standard deviation in meters of the mean height of the people in the boxes.

    Sources are the height of the local people (population mean and finite sample) and the excess
    size of detector boxes over people.

    Args:
        people_at_a_time: mean number of matched people per frame; a lower bound of the number of
            distinct people, so the sampling error is overestimated.
        settings: constants.
    """
    sample = settings.person_height_sd**2 / max(people_at_a_time, 1.0)
    slack = settings.box_slack_sd * settings.person_height
    return float(np.sqrt(settings.crowd_height_sd**2 + sample + slack**2))
