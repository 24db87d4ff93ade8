"""Fit of a rig from people to anchors: scale, map frame and cameras, with contradictions.

The rig, the height of its crowd and the anchors are Gaussian measurements of the same cameras. The
sum of their squared standardized residuals is minimized over the cameras, the scale and the map
frame. Each anchor, and the crowd's height, is compared with the prediction from all others; the one
that contradicts the others most is set aside, until none does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy  # scipy.stats is slow to import, so it is loaded on use
from jaxtyping import Bool, Float

from catfree.calibration.people._radial_lens import RadialLenses, radial_distortion
from catfree.calibration.people._register import Calibration
from catfree.calibration.people.anchors._anchors import (
    Anchor,
    AnchorCheck,
    resolve_anchors,
)
from catfree.calibration.people.anchors._measurements import (
    DISTANCE,
    FOCAL,
    HEIGHT,
    PEOPLE,
    POINT,
    POSITION,
    QUANTITIES,
    ROTATION,
    Measurement,
    linearize,
    map_cameras,
    measurements_of,
    stack,
)
from catfree.calibration.people.anchors._mixed_model import MixedFit, fit_mixed_model
from catfree.calibration.people.cameras._camera_model import (
    LOG_FOCAL,
    PAN,
    of_rig,
    rotation,
    scene_of,
)
from catfree.calibration.people.cameras._rig_deviation import scale_deviation, shape_deviation
from catfree.errors import CalibrationError, InvalidInputError, shortened
from catfree.geometry._buckets import padded
from catfree.settings import CalibrationSettings
from catfree.types import GeoReference
from catfree.types._validation import shown_camera

FARTHEST = 20.0  # logarithm of the scale or a focal length at which a fit has diverged
SAME = 1e-6  # difference of two sums of squares due to rounding
UNKNOWN = 1e3  # relative standard deviation of an unknown height
FLATTEST = 0.01  # radians below the horizon; pixels must see nearer ground
UNCHECKED = 1e-9  # share of a measurement's information below which it is not checked by others
ON_MAP = (POSITION, ROTATION, POINT)
LOGARITHMS = (DISTANCE, HEIGHT, FOCAL, PEOPLE)


class _Innovation(NamedTuple):
    """A measurement minus its prediction from all others.

    Attributes:
        off: (d,) the difference, NaN where nothing else determines it.
        covariance: (d, d) of the difference.
        log_p: natural logarithm of the probability of a larger difference by chance.
    """

    off: Float[np.ndarray, " d"]
    covariance: Float[np.ndarray, "d d"]
    log_p: float


def anchored(
    calibration: Calibration,
    anchors: Sequence[Anchor],
    settings: CalibrationSettings | None = None,
    *,
    camera_names: Sequence[str] | None = None,
) -> Calibration:
    """Fit a rig from people to anchors.

    Args:
        calibration: the rig, without anchors.
        anchors: independent measurements. With positions on a map, the scene is returned in the
            map's frame; with longitudes and latitudes, in meters east and north of their middle.
        settings: constants.
        camera_names: names by which anchors may refer to cameras.

    Returns:
        The rig in meters, with each anchor compared with all other evidence in `anchors`. An anchor
        that contradicts the people and the other anchors is not used. If the crowd's height
        contradicts the anchors, it counts as unknown within `unusual_height_sd`.

    Raises:
        InvalidInputError: if an anchor's camera does not exist, its pixel is outside the image or
            above the horizon, or positions on the map are too few.
        CalibrationError: if only unregistered cameras see the map, or if consistent anchors imply
            an impossible height of the people.
    """
    settings = CalibrationSettings() if settings is None else settings
    rig = calibration.scene.rig
    index, earth = resolve_anchors(anchors, rig.image_size, camera_names)
    if not anchors:
        return calibration
    registered = rig.registered
    cameras = np.nan_to_num(of_rig(rig))
    stated = measurements_of(anchors, index, rig, earth)
    usable = [m for m in stated if registered[m.camera]]
    _require_ground(usable, cameras, camera_names)
    start = _start(usable, cameras)
    if len(start) < 4 and any(m.kind in ON_MAP for m in stated):
        unseen = sorted({c for c in index if not registered[c]})
        listed = ", ".join(shown_camera(c, camera_names) for c in unseen)
        raise CalibrationError(
            "The anchors on the map are seen only by cameras that are not registered "
            f"({shortened(listed)}). Add points or positions of registered cameras."
        )
    deviation = calibration.crowd_height_sd / calibration.crowd_height
    people = Measurement(None, PEOPLE, 0, np.zeros((2, 2)), np.zeros(1), deviation, 0.0)
    unusual = settings.unusual_height_sd / settings.person_height
    problem = _Problem([*usable, people], cameras, _prior(calibration), start, unusual)
    chosen, fit, innovations = _consistent(problem, np.log(settings.anchor_level))
    results = zip(innovations, chosen.tolist(), strict=True)
    found = [next(results) if registered[m.camera] else (None, False) for m in stated]
    checks = [
        _check(m, innovation, calibration, camera_names, used=is_used)
        for m, (innovation, is_used) in zip([*stated, people], [*found, *results], strict=True)
    ]
    innovation = innovations[-1]
    if innovation.log_p < np.log(settings.anchor_level):
        tall = calibration.crowd_height * np.exp(-innovation.off[0])
        raise CalibrationError(
            f"By the anchors the people are {tall:.2f} m tall on average, which is impossible. "
            "Check that the anchors are in meters."
        )
    return _described(calibration, fit, tuple(checks), earth)


@dataclass(frozen=True)
class _Problem:
    """All measurements.

    Attributes:
        measured: m measurements of registered cameras, and last the usual height of the crowd.
        cameras: (C, 7) cameras from the people.
        prior: (7C, 7C) their covariance.
        start: (f,) initial values of the free entries of the map frame.
        unusual: relative standard deviation of the height of a crowd that contradicts anchors.
    """

    measured: list[Measurement]
    cameras: Float[np.ndarray, "cam 7"]
    prior: Float[np.ndarray, "n n"]
    start: Float[np.ndarray, " f"]
    unusual: float

    def contradiction(self) -> CalibrationError:
        """Make the error that nothing fits, saying what to check."""
        if len(self.start) < 4:
            return CalibrationError(
                "The lengths and heights of the anchors contradict the people and each other; "
                "check that they are in meters, and check the pixels of lengths."
            )
        return CalibrationError(
            "The anchors on the map contradict the people and each other; check their units, the "
            "order of x and y, and whether x, y and up are right-handed."
        )

    def misfit_without(self, chosen: Bool[np.ndarray, " u"], at: int) -> float:
        """Sum of squares without one of the chosen measurements, or without the crowd's height.

        It is infinite if the map frame is no longer determined, or the fit diverges.
        """
        if at == len(chosen) - 1:
            return float(self.fit(chosen, UNKNOWN).misfit)
        rest = chosen & (np.arange(len(chosen)) != at)
        if len(_start(list(compress(self.measured, rest)), self.cameras)) < len(self.start):
            return np.inf
        try:
            return float(self.fit(rest).misfit)
        except CalibrationError:
            return np.inf

    def fit(self, chosen: Bool[np.ndarray, " u"], crowd: float | None = None) -> MixedFit:
        """Fit cameras and map frame to the chosen measurements and the crowd's height.

        Args:
            chosen: (m + 1,) the measurements to fit, and last whether the crowd's height is usual.
            crowd: relative standard deviation of the crowd's height, if neither the usual nor the
                unusual one.

        Raises:
            CalibrationError: if the fit diverges.
        """
        if crowd is None:
            crowd = self.measured[-1].sd if chosen[-1] else self.unusual
        people = self.measured[-1]._replace(sd=crowd)
        with jax.enable_x64(True):
            stated = stack([*self.measured[:-1], people])
            found = fit_mixed_model(
                stated,
                padded(np.append(chosen[:-1], True), len(stated.kind)),
                jnp.asarray(self.cameras),
                jnp.asarray(self.prior),
                padded(self.start, 4),
                jnp.arange(4) < len(self.start),
            )
        fit = jax.tree.map(np.asarray, found)
        logarithms = np.append(fit.cameras[:, LOG_FOCAL], fit.frame[0])
        if not (np.abs(logarithms).max() < FARTHEST and np.isfinite(fit.misfit)):
            raise self.contradiction()
        return fit

    def innovations(self, fit: MixedFit, chosen: Bool[np.ndarray, " u"]) -> list[_Innovation]:
        """Compare each measurement, in use or not, and last the crowd's height with all others.

        Source: Baarda (1968), "A testing procedure for use in geodetic networks".
        """
        slopes, noise, off = map(np.asarray, fit.compared)
        covariance, information, error = map(
            np.asarray, (fit.covariance, fit.information, fit.error)
        )
        found = []
        for at, m in enumerate(self.measured):
            own = slice(len(m.value))
            block, k = noise[at, own, own], 3 * at + np.arange(len(m.value))
            if chosen[at] or m.kind == PEOPLE:
                found.append(_innovation(block, information[np.ix_(k, k)], error[k]))
            else:
                J = slopes[at, own]
                alone = np.linalg.inv(J @ covariance @ J.T + block)
                found.append(_innovation(block, alone, alone @ off[at, own]))
        return found


def _consistent(
    problem: _Problem, least: float
) -> tuple[Bool[np.ndarray, " u"], MixedFit, list[_Innovation]]:
    """Set aside contradicting measurements one by one, until none contradicts the others.

    Of those that contradict, the one without which the others agree best is set aside; the crowd's
    height goes before a measurement that would do equally well. One that agrees again afterward
    returns once.

    Args:
        problem: all measurements.
        least: log probability below which a difference is a contradiction.

    Returns:
        A mask of the m measurements in use and, last, of the usual height of the crowd; the fit;
        and the innovation of each measurement.

    Raises:
        CalibrationError: if the map frame is not determined by what remains, or the fit diverges.
    """
    crowd = len(problem.measured) - 1
    chosen = np.ones(crowd + 1, bool)
    returned = np.arange(crowd + 1) == crowd  # the crowd never returns
    while True:
        fit = problem.fit(chosen)
        innovations = problem.innovations(fit, chosen)
        log_p = np.array([innovation.log_p for innovation in innovations])
        against = np.flatnonzero(chosen & (log_p < least))
        if len(against):
            left = [problem.misfit_without(chosen, int(at)) for at in against]
            if np.isinf(left).all():
                raise problem.contradiction()
            # With exact measurements, rounding can make a sum of squares negative.
            same = against[np.array(left) <= min(left) + SAME * (1 + abs(min(left)))]
            chosen[crowd] = True
            chosen[crowd if same[-1] == crowd else same[0]] = False
            continue
        again = np.flatnonzero(~chosen & ~returned & (log_p >= least))
        if not len(again):
            return chosen, fit, innovations
        chosen[again[0]] = returned[again[0]] = True


def _prior(calibration: Calibration) -> Float[np.ndarray, "n n"]:
    """(7C, 7C) covariance of the cameras, vague where it is unknown."""
    size = 7 * len(calibration.camera_covariance)
    covariance = calibration.camera_covariance.reshape(size, size)
    known = np.isfinite(np.diag(covariance))
    return np.where(known & known[:, None], covariance, np.diag(np.where(known, 0.0, 1.0)))


def _require_ground(
    usable: Sequence[Measurement],
    cameras: Float[np.ndarray, "cam 7"],
    camera_names: Sequence[str] | None,
) -> None:
    """Raise if a pixel does not see the ground.

    Raises:
        InvalidInputError: naming the camera.
    """
    for m in usable:
        if m.kind not in (DISTANCE, POINT):
            continue
        R = rotation(cameras[m.camera])
        ray = m.pixels / np.exp(cameras[m.camera, LOG_FOCAL]) @ R[:2] + R[2]
        if (ray[:, 2] > -FLATTEST * np.linalg.norm(ray, axis=1)).any():
            raise InvalidInputError(
                f"{_name(m, camera_names)} has a pixel at or above the horizon; an anchor needs "
                "points on the ground."
            )


def _start(
    usable: Sequence[Measurement], cameras: Float[np.ndarray, "cam 7"]
) -> Float[np.ndarray, " f"]:
    """The map frame that fits best, ignoring standard deviations.

    The last three entries are omitted, and stay 0, unless anchors on a map determine them.
    """
    on = [m for m in usable if m.kind in (POSITION, POINT)]
    turned = [m for m in usable if m.kind == ROTATION]
    places = np.array([m.value[:2] for m in on]).reshape(-1, 2)
    distinct = len(np.unique(places, axis=0))
    if distinct + bool(turned) < 2:
        return np.zeros(1)
    with jax.enable_x64(True):
        compared = linearize(stack(on), jnp.asarray(cameras), jnp.zeros(4))
        points = places - np.asarray(compared.off)[: len(on), :2]
    if distinct > 1:
        # In complex numbers, a rotation times a scale is one factor.
        near, far = ((xy - xy.mean(0)) @ np.array([1, 1j]) for xy in (points, places))
        factor = (near.conj() @ far) / max((near.conj() @ near).real, 1e-12)
        scale, angle = max(abs(factor), 1e-3), float(np.angle(factor))
    else:
        scale, angle = 1.0, float(turned[0].value[2] - cameras[turned[0].camera, PAN])
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    shift = (places - points @ np.array([[c, s], [-s, c]])).mean(0)
    return np.array([np.log(scale), angle, *shift])


def _innovation(
    noise: Float[np.ndarray, "d d"],
    information: Float[np.ndarray, "d d"],
    error: Float[np.ndarray, " d"],
) -> _Innovation:
    """Compare a measurement with its prediction from all others.

    Args:
        noise: covariance of the stated value.
        information: inverse covariance of stated minus predicted, 0 where nothing predicts it.
        error: `information` times (stated minus predicted).
    """
    root = np.linalg.cholesky(noise)
    share, axes = np.linalg.eigh(root.T @ information @ root)
    checked = share > UNCHECKED
    # Directions that nothing else determines have no innovation.
    inverse = np.where(checked, 1 / np.where(checked, share, 1), np.nan)
    white = axes.T @ root.T @ error
    squared = np.nansum(inverse * white**2)
    log_p = float(scipy.stats.chi2.logsf(squared, checked.sum())) if checked.any() else 0.0
    spread = root @ axes @ (inverse[:, None] * axes.T) @ root.T
    return _Innovation(root @ axes @ (inverse * white), spread, log_p)


def _check(
    measurement: Measurement,
    innovation: _Innovation | None,
    calibration: Calibration,
    camera_names: Sequence[str] | None,
    *,
    used: bool,
) -> AnchorCheck:
    """Compare one stated quantity with all other evidence; None if there is none."""
    anchor, kind, value = measurement.anchor, measurement.kind, measurement.value
    about = _name(measurement, camera_names)
    if innovation is None:
        nothing = (np.nan,) * len(value)
        sentence = f"{about} was not used: the camera is not registered."
        return AnchorCheck(anchor, QUANTITIES[kind], nothing, nothing, 1.0, False, sentence)
    sd = np.sqrt(np.diag(innovation.covariance))
    if kind in LOGARITHMS:
        unit = calibration.crowd_height if kind == PEOPLE else 1.0
        other = unit * np.exp(value - innovation.off)
        difference, sd = unit * np.exp(value) - other, other * sd
        what = f"is {_amount(kind, other[0])} (sd {_amount(kind, sd[0])})"
    else:
        factor, unit = (np.rad2deg(1.0), "degrees") if kind == ROTATION else (1.0, "m")
        difference, sd = factor * innovation.off, factor * sd
        what = (
            f"is off by {np.linalg.norm(difference):.2f} {unit} "
            f"(sd {np.sqrt((sd**2).sum()):.2f} {unit})"
        )
    if kind == PEOPLE:
        sentence = _about_people(calibration, calibration.crowd_height - difference[0], used=used)
    elif np.isnan(difference).all():
        sentence = f"{about} cannot be checked: nothing else determines it."
    else:
        sentence = f"{about} {what} by the people and the other anchors"
        sentence += "." if used else ": it contradicts them and was not used."
    numbers = tuple(difference.tolist()), tuple(sd.tolist()), float(np.exp(innovation.log_p))
    return AnchorCheck(anchor, QUANTITIES[kind], *numbers, used, sentence)


def _about_people(calibration: Calibration, height: float, *, used: bool) -> str:
    """Compare the people's height according to the anchors, if known, with the expected one."""
    expected = f"{calibration.crowd_height:.2f} m (sd {calibration.crowd_height_sd:.2f} m)"
    if np.isnan(height):
        return f"No anchor tells how tall the people are; {expected} on average is assumed."
    sentence = f"By the anchors the people are {height:.2f} m tall on average"
    if used:
        return f"{sentence}; {expected} was expected."
    return (
        f"{sentence}, but {expected} was expected, so their height is not used: they are not the "
        "usual adults, or an anchor is wrong."
    )


def _name(measurement: Measurement, camera_names: Sequence[str] | None) -> str:
    """Name a stated quantity at the beginning of a sentence."""
    kind, value = measurement.kind, measurement.value
    stated = ""
    if kind in LOGARITHMS:
        stated = f" of {_amount(kind, np.exp(value[0]))}"
    elif kind == POINT:
        stated = f" ({value[0]:.2f}, {value[1]:.2f})"
    where = "in" if kind in (DISTANCE, POINT) else "of"
    camera = shown_camera(measurement.camera, camera_names)
    return f"The {QUANTITIES[kind]}{stated} {where} camera {camera}"


def _amount(kind: int, value: float) -> str:
    """A focal length in pixels, or another length in meters."""
    return f"{value:.0f} px" if kind == FOCAL else f"{value:.2f} m"


def _described(
    calibration: Calibration,
    fit: MixedFit,
    checks: tuple[AnchorCheck, ...],
    earth: GeoReference | None,
) -> Calibration:
    """Describe the fitted cameras as a calibration in the frame of the anchors."""
    rig, count = calibration.scene.rig, len(fit.cameras)
    known = rig.registered
    cameras, J = map_cameras(np.asarray(fit.cameras), np.asarray(fit.frame))
    covariance = (J @ fit.covariance @ J.T).reshape(count, 7, count, 7)
    focal = np.exp(cameras[:, LOG_FOCAL])
    lenses = RadialLenses(np.asarray(rig.K, np.float64)[:, 0, 0], radial_distortion(rig))
    bent = lenses.of_focal(focal).k1
    scene = scene_of(np.where(known[:, None], cameras, np.nan), rig.image_size, bent)
    scale = float(np.exp(fit.frame[0]))
    crowd_height = calibration.crowd_height * scale
    return replace(
        calibration,
        scene=replace(
            scene, georeference=earth, rig_sd=shape_deviation(cameras, covariance, known)
        ),
        camera_covariance=covariance,
        scale_sd=scale_deviation(cameras, covariance, known),
        crowd_height=crowd_height,
        crowd_height_sd=float(crowd_height * np.sqrt(fit.covariance[-4, -4])),
        foot_offset=calibration.foot_offset * scale,
        anchors=checks,
    )
