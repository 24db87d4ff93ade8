"""Refinement of placements of one camera against people with known positions.

A placement from voting has the errors of a single view (a degree, a tenth of the range), which make
correct placements look wrong. Every candidate is therefore refined before it is judged.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.adjustment._people_bundle import camera_prior
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, ROLL, X, Z, projection
from catfree.calibration.people.cameras._ground_map import GroundMap, map_camera
from catfree.calibration.people.matching._mutual_nearest import mutual_nearest
from catfree.geometry._buckets import padded, padded_length
from catfree.geometry._least_squares import (
    CAUCHY,
    Residuals,
    SchurLevenbergMarquardt,
    Unknowns,
    cauchy,
    minimize,
    robust,
)
from catfree.geometry._person import box_edges
from catfree.settings import CalibrationSettings
from catfree.types._annotations import HostOrDevice

TOLERANCES = (0.10, 0.06, 0.03)  # fraction of the range, decreasing as the camera converges
MOST_STEPS = 8  # per fit
HEIGHTS = (0.5, 60.0)  # meters; a camera beyond these bounds diverges, as a mirrored one does
FEWEST_MATCHES = 6  # per camera; fewer do not determine it
MATCHES_BLOCK = 1024  # matches are padded to this number, or to a power of four times it
FITS_BLOCK = 4  # fits are padded likewise


class MatchedPeople(NamedTuple):
    """Boxes of one camera and the people of a map that they show.

    Attributes:
        box: (n, 3) box center, top row, bottom row in pixels from the image center.
        information: (n,) inverse variances of the edges in pixels; 0 where there is no box.
        people: (n, 3) ground position and height in meters.
        covariance: (n, 3, 3) of the people in square meters.
    """

    box: Float[HostOrDevice, "n 3"]
    information: Float[HostOrDevice, " n"]
    people: Float[HostOrDevice, "n 3"]
    covariance: Float[HostOrDevice, "n 3 3"]


def resect(
    camera: int,
    placements: Sequence[tuple[BoxGrid, Float[np.ndarray, "7"]]],
    people: GroundMap,
    settings: CalibrationSettings,
    *,
    log_focal: float,
) -> dict[int, Float[np.ndarray, "7"]]:
    """Refine all placements of one camera together against a fixed map of people.

    Args:
        camera: index of the camera.
        placements: for each placement, all boxes and (7,) initial parameters in world coordinates.
        people: map of the other cameras for the same frames.
        settings: constants.
        log_focal: mean of the prior on log focal length; `focal_spread` is its deviation.

    Returns:
        (7,) refined parameters by index of the placement, except for placements that diverge or
        match too few people.
    """
    refined = {at: start for at, (_, start) in enumerate(placements)}
    for tolerance in TOLERANCES:
        matches: dict[int, MatchedPeople] = {}
        for at, parameters in refined.items():
            grid = placements[at][0]
            own_map = map_camera(grid, camera, parameters, settings, tolerance)
            matched = _match(grid, camera, own_map, people, settings.match_gate)
            if len(matched.box) >= FEWEST_MATCHES:
                matches[at] = matched
        fitted = fit_cameras(
            [refined[at] for at in matches],
            list(matches.values()),
            settings,
            log_focal=log_focal,
        )
        refined = {
            at: parameters
            for at, parameters in zip(matches, fitted, strict=True)
            if HEIGHTS[0] < parameters[Z] < HEIGHTS[1]
        }
    return refined


def _match(
    grid: BoxGrid, camera: int, own_map: GroundMap, people: GroundMap, gate: float
) -> MatchedPeople:
    time, slot, partner, *_ = mutual_nearest(own_map, people, gate)
    covariance = np.zeros((len(time), 3, 3))
    covariance[:, :2, :2] = people.covariance[time, partner]
    covariance[:, 2, 2] = people.height_sd[time, partner] ** 2
    return MatchedPeople(
        grid.box[camera, time, slot],
        1 / grid.sd[camera, time, slot] ** 2,
        np.column_stack([people.xy[time, partner], people.height[time, partner]]),
        covariance,
    )


def fit_cameras(
    starts: Sequence[Float[np.ndarray, "7"]],
    matches: Sequence[MatchedPeople],
    settings: CalibrationSettings,
    *,
    log_focal: float,
) -> Float[np.ndarray, "fit 7"]:
    """Fit the seven parameters of cameras by Levenberg-Marquardt with a Cauchy loss.

    Args:
        starts: (7,) initial parameters of each fit.
        matches: boxes and people of each fit.
        settings: constants.
        log_focal: mean of the prior on log focal length; `focal_spread` is its deviation.

    Returns:
        (F, 7) the parameters with the smallest cost.
    """
    if not matches:
        return np.zeros((0, 7))
    n = padded_length(max(len(one.box) for one in matches), MATCHES_BLOCK)
    fits = padded_length(len(matches), FITS_BLOCK)
    mean, precision = np.zeros((1, 7)), np.zeros((1, 7))
    mean[0, LOG_FOCAL] = log_focal
    precision[0, LOG_FOCAL] = 1 / settings.focal_spread
    precision[0, ROLL] = 1 / settings.roll_sd

    def stacked(*rows: np.ndarray) -> Array:
        table = np.zeros((fits, n, *rows[0].shape[1:]))
        for at, row in enumerate(rows):
            table[at, : len(row)] = row
        return jax.device_put(table)

    with jax.enable_x64(True):
        fitted = _fit(
            padded(np.stack(starts)[:, None], fits),
            jax.tree.map(stacked, *matches),
            _Known(*map(jnp.asarray, (settings.foot_offset, mean, precision))),
        )
        return np.asarray(fitted)[: len(matches), 0]


class _Known(NamedTuple):
    """The foot offset, and mean and inverse standard deviations of the prior on a camera."""

    foot_offset: Float[Array, ""]
    mean: Float[Array, "1 7"]
    precision: Float[Array, "1 7"]


def _edges(
    camera: Float[Array, "7"], people: Float[HostOrDevice, "n 3"], foot_offset: Float[Array, ""]
) -> Float[Array, "n 3"]:
    shown = jax.vmap(box_edges, (None, 0, None, None))
    return shown(projection(camera), people, camera[X:Z], foot_offset)


def _problem(
    unknowns: Unknowns, args: tuple[Float[Array, "0"], tuple[MatchedPeople, Array, _Known]]
) -> tuple[Residuals, Residuals]:
    """Residuals of one camera (1, 7), given the people and the precision of their boxes."""
    matched, precision, known = args[1]
    box = _edges(unknowns.view[0], matched.people, known.foot_offset)
    residuals = Residuals(
        ((box - matched.box) * precision)[None, :, :, None],
        camera_prior(unknowns.view, known.mean, known.precision),
        unknowns.block,
    )
    return robust(residuals, partial(cauchy, width=CAUCHY))


@jax.jit
def _fit(
    starts: Float[Array, "fit 1 7"], matches: MatchedPeople, known: _Known
) -> Float[Array, "fit 1 7"]:
    """The cameras with the smallest cost, one per start and its row of `matches`."""
    solver = SchurLevenbergMarquardt(most_steps=MOST_STEPS)

    def fit(one: tuple[Array, MatchedPeople]) -> Array:
        start, matched = one
        slope = jax.jacfwd(lambda person: _edges(start[0], person[None], known.foot_offset)[0])
        by_person = jax.vmap(slope)(matched.people)
        # The uncertainty of the people adds to the noise.
        spread = jnp.einsum("nij,njk,nik->ni", by_person, matched.covariance, by_person)
        information = matched.information[:, None]
        precision = jnp.sqrt(information / (1 + information * spread))
        unknowns = Unknowns(start, jnp.zeros((len(precision), 0), start.dtype))
        args = jnp.zeros(0, start.dtype), (matched, precision, known)
        return minimize(_problem, unknowns, args, solver).value.view

    return jax.lax.map(fit, (starts, matches))  # each ends when it converges
