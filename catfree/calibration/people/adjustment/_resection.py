"""Refine one camera against people with known positions.

A placement from voting has the errors of a single view (a degree, a tenth of the range), which make
correct placements look wrong. Every candidate is therefore refined before it is judged.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.adjustment._people_bundle import CAUCHY, CONVERGED, camera_prior
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, ROLL, X, Z, projection
from catfree.calibration.people.cameras._ground_map import GroundMap, map_ground
from catfree.calibration.people.matching._mutual_nearest import mutual_nearest
from catfree.geometry._buckets import coarse_length, padded
from catfree.geometry._least_squares import (
    Residuals,
    SchurLevenbergMarquardt,
    Unknowns,
    cauchy,
    minimize,
    robust,
)
from catfree.geometry._person import box_edges
from catfree.settings import CalibrationSettings

TOLERANCES = (0.10, 0.06, 0.03)  # fraction of the range, decreasing as the camera converges
PASSES = 2
FEWEST_MATCHES = 6
MATCHES_BLOCK = 1024  # matches are padded to this number, or to a power of four times it


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
                *grid.of_camera(camera),
                settings,
                foot_offset=foot_offset,
                range_tolerance=tolerance,
            )
            time, slot, partner, *_ = mutual_nearest(own_map, people, settings.match_gate)
            if len(time) < FEWEST_MATCHES:
                return None
            measured = grid.edges((camera, time, slot))
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
    n = coarse_length(len(xy), MATCHES_BLOCK)
    mean, precision = np.zeros((1, 7)), np.zeros((1, 7))
    mean[0, LOG_FOCAL] = log_focal[0]
    precision[0, LOG_FOCAL], precision[0, ROLL] = 1 / log_focal[1], 1 / settings.roll_sd
    with jax.enable_x64(True):
        fitted = _fit(
            jnp.asarray(start[None]),
            padded(np.column_stack([xy, height]), n),
            padded(measured, n),
            padded(1 / sd**2, n),
            padded(covariance, n),
            jnp.asarray(foot_offset),
            jnp.asarray(mean),
            jnp.asarray(precision),
            jnp.asarray(iterations, jnp.int32),
        )
        return np.asarray(fitted)[0]


class _Matches(NamedTuple):
    """Boxes (n, 3), their inverse deviations and their people (n, 3), and the camera's prior."""

    box: Float[Array, "n 3"]
    precision: Float[Array, "n 3"]
    people: Float[Array, "n 3"]
    foot_offset: Float[Array, ""]
    mean: Float[Array, "1 7"]
    camera_precision: Float[Array, "1 7"]


def _edges(
    camera: Float[Array, "7"], people: Float[Array, "n 3"], foot_offset: Float[Array, ""]
) -> Float[Array, "n 3"]:
    shown = jax.vmap(box_edges, (None, None, 0, None))
    return shown(projection(camera), camera[X:Z], people, foot_offset)


def _problem(
    unknowns: Unknowns, args: tuple[Float[Array, "0"], _Matches]
) -> tuple[Residuals, Residuals]:
    """Residuals of one camera (1, 7); the people are given."""
    matches = args[1]
    box = _edges(unknowns.view[0], matches.people, matches.foot_offset)
    residuals = Residuals(
        ((box - matches.box) * matches.precision)[None, :, :, None],
        camera_prior(unknowns.view, matches.mean, matches.camera_precision),
        unknowns.block,
    )
    return robust(residuals, partial(cauchy, width=CAUCHY))


@jax.jit
def _fit(
    start: Float[Array, "1 7"],
    people: Float[Array, "n 3"],
    box: Float[Array, "n 3"],
    information: Float[Array, " n"],
    covariance: Float[Array, "n 3 3"],
    foot_offset: Float[Array, ""],
    mean: Float[Array, "1 7"],
    camera_precision: Float[Array, "1 7"],
    most_steps: Array,
) -> Float[Array, "1 7"]:
    """The camera with the smallest cost; boxes without information are absent."""
    by_person = jax.vmap(jax.jacfwd(lambda p: _edges(start[0], p[None], foot_offset)[0]))(people)
    # The uncertainty of the people adds to the noise.
    spread = jnp.einsum("nij,njk,nik->ni", by_person, covariance, by_person)
    precision = jnp.sqrt(information[:, None] / (1 + information[:, None] * spread))
    matches = _Matches(box, precision, people, foot_offset, mean, camera_precision)
    unknowns = Unknowns(start, jnp.zeros((len(people), 0), start.dtype))
    args = jnp.zeros(0, start.dtype), matches
    solver = SchurLevenbergMarquardt(CONVERGED, 0.0, most_steps=most_steps)
    return minimize(_problem, unknowns, args, solver).value.view
