"""Fit a rig from people to anchors: scale, map frame and cameras, and who contradicts whom.

The rig, the height of its crowd and the anchors are Gaussian measurements of the same cameras. The
sum of their squared standardized residuals is minimized over the cameras, the scale and the map
frame. Each anchor, and the crowd's height, is compared with what all others predict; the one that
contradicts the others most is set aside until none does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np
import scipy  # its statistics, which take long to import, where they are used
from jaxtyping import Bool, Float

from catfree.calibration.people._register import Calibration
from catfree.calibration.people.adjustment._anchor_residuals import (
    DISTANCE,
    FOCAL,
    HEIGHT,
    POINT,
    POSITION,
    QUANTITIES,
    ROTATION,
    Measurement,
    linearize,
    map_cameras,
    measurements_of,
)
from catfree.calibration.people.adjustment._anchors import (
    Anchor,
    AnchorCheck,
    resolve_anchors,
)
from catfree.calibration.people.cameras._camera_model import (
    LOG_FOCAL,
    PAN,
    X,
    of_rig,
    to_matrices,
)
from catfree.calibration.people.cameras._rig_deviation import scale_variance, shape_deviation
from catfree.errors import CalibrationError, InvalidInputError, shortened
from catfree.settings import CalibrationSettings
from catfree.types import GeoReference, Rig, Scene

ROUNDS = 20  # of linearization; a fit takes four
CONVERGED = 1e-9  # meters, radians and relative
SAME = 1e-6  # difference of two sums of squares that rounding explains
UNKNOWN = 1e3  # relative standard deviation of a height of which nothing is known
FLATTEST = 0.01  # radians below the horizon; a pixel sees nearer ground
UNCHECKED = 1e-6  # share of a measurement's information below which nothing else determines it
ON_MAP = (POSITION, ROTATION, POINT)
LOGARITHMS = (DISTANCE, HEIGHT, FOCAL)


class _Frame(NamedTuple):
    """What the map frame may do: its columns (log scale, heading, x, y) that anchors determine."""

    start: Float[np.ndarray, "4"]
    free: int


@dataclass(frozen=True)
class _Fit:
    """Cameras and map frame that fit the measurements in use.

    Attributes:
        cameras: (C, 7) in the frame of the people.
        frame: (4,) the map frame.
        covariance: (7C + 4, 7C + 4) of both.
        innovation: for each measurement in use, stated minus predicted by all others, (d,), NaN
            where nothing else determines it; the last one is the crowd's.
        innovation_covariance: (d, d) of these.
        log_p: natural logarithm of the probability of a larger innovation by chance.
        misfit: sum of squares of the standardized residuals.
    """

    cameras: Float[np.ndarray, "cam 7"]
    frame: Float[np.ndarray, "4"]
    covariance: Float[np.ndarray, "n n"]
    innovation: list[np.ndarray]
    innovation_covariance: list[np.ndarray]
    log_p: Float[np.ndarray, " m"]
    misfit: float


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
        anchors: what is known from elsewhere; with positions on a map, the scene comes out in the
            map's frame, and with longitudes and latitudes in meters east and north of their middle.
        settings: constants.
        camera_names: names of the cameras, by which anchors may refer to them.

    Returns:
        The rig in meters, with `anchors` compared with everything else. An anchor that contradicts
        the people and the other anchors is not used. If the crowd's height contradicts the anchors,
        it counts as unknown within `unusual_height_sd`.

    Raises:
        InvalidInputError: if an anchor refers to no camera, shows no ground, or if positions on the
            map are too few.
        CalibrationError: if only cameras that are not registered see the map.
    """
    settings = CalibrationSettings() if settings is None else settings
    rig = calibration.scene.rig
    index, earth = resolve_anchors(anchors, rig.camera_count, camera_names)
    if not anchors:
        return calibration
    names = [str(c) for c in range(rig.camera_count)] if camera_names is None else camera_names
    registered = np.asarray(rig.registered)
    cameras = _parameters(rig)
    stated = measurements_of(anchors, index, rig, earth)
    usable = [m for m in stated if registered[m.camera]]
    _require_ground(usable, cameras, names)
    frame = _start(usable, cameras)
    if frame.free < 4 and any(m.kind in ON_MAP for m in stated):
        unseen = sorted({c for c in index if not registered[c]})
        raise CalibrationError(
            "The anchors on the map are seen by cameras that are not registered "
            f"({shortened(', '.join(str(names[c]) for c in unseen))}). Add points or positions of "
            "others."
        )
    problem = _Problem(
        usable,
        cameras,
        _prior(calibration),
        frame,
        calibration.crowd_height_sd / calibration.crowd_height,
        settings.unusual_height_sd / settings.person_height,
    )
    chosen, typical = _consistent(problem, np.log(settings.anchor_level))
    fit = problem.fit(chosen, typical=typical)
    checks, taken = [], iter(chosen)
    results = zip(fit.innovation, fit.innovation_covariance, fit.log_p, strict=True)
    for m in stated:
        if registered[m.camera]:
            is_used = bool(next(taken))
            result = next(results) if is_used else _unused(m, fit)
            checks.append(_check(m, anchors[m.anchor], *result, names, used=is_used))
        else:
            reason = f"{_name(m, names)} was not used: the camera is not registered."
            nothing = (np.nan,) * len(m.value)
            kind = QUANTITIES[m.kind]
            checks.append(
                AnchorCheck(anchors[m.anchor], kind, nothing, nothing, 1.0, False, reason)
            )
    (off,), ((variance,),), log_p = next(results)
    checks.append(_check_of_crowd(calibration, off, variance, log_p, used=typical))
    return _described(calibration, fit, tuple(checks), earth)


@dataclass(frozen=True)
class _Problem:
    """Everything that is measured.

    Attributes:
        usable: m measurements of registered cameras.
        cameras: (C, 7) cameras from the people.
        prior: (7C, 7C) their covariance.
        frame: where the map frame starts, and how many of its entries are unknown.
        crowd: relative standard deviation of the crowd's height.
        unusual: the same of a crowd that contradicts anchors.
    """

    usable: list[Measurement]
    cameras: Float[np.ndarray, "cam 7"]
    prior: Float[np.ndarray, "n n"]
    frame: _Frame
    crowd: float
    unusual: float

    def fit(self, chosen: Bool[np.ndarray, " m"], *, typical: bool) -> _Fit:
        """Fit the chosen measurements, with the crowd's height as usual or as unusual."""
        return self._fit(chosen, self.crowd if typical else self.unusual)

    def misfit_without(self, chosen: Bool[np.ndarray, " m"], at: int, *, typical: bool) -> float:
        """Sum of squares without one of the chosen measurements, or without the crowd's height.

        Infinite if the map frame is no longer determined.
        """
        if at == len(chosen):
            return self._fit(chosen, UNKNOWN).misfit
        rest = chosen & (np.arange(len(chosen)) != at)
        if _start(list(compress(self.usable, rest)), self.cameras).free < self.frame.free:
            return np.inf
        return self.fit(rest, typical=typical).misfit

    def _fit(self, chosen: Bool[np.ndarray, " m"], crowd: float) -> _Fit:
        """Fit cameras and map frame to the chosen measurements and the crowd's height.

        Source: Gauss-Newton for observations with unknown and with random parameters ("mixed
            model"), and the test of each observation against the others of Baarda (1968), "A
            testing procedure for use in geodetic networks".
        """
        used = list(compress(self.usable, chosen))
        cameras, prior, frame = self.cameras, self.prior, self.frame
        at, place = cameras, frame.start
        equations = _Equations.of(used, cameras, at, place, frame.free, crowd)
        for _ in range(ROUNDS):
            moved, step = equations.solve(prior)
            change = max(np.abs(step).max(), np.abs(cameras + moved - at).max())
            at, place = cameras + moved, place + np.pad(step, (0, 4 - frame.free))
            equations = _Equations.of(used, cameras, at, place, frame.free, crowd)
            if change < CONVERGED:
                break
        W, Q, M = equations.inverses(prior)
        noise, off, error = equations.noise, equations.off, M @ equations.off
        gain = prior @ equations.by_camera.T
        cross = -gain @ W @ equations.by_frame @ Q
        joint = np.zeros((cameras.size + 4,) * 2)
        n, f = cameras.size, cameras.size + frame.free
        joint[:n, :n] = prior - gain @ M @ gain.T
        joint[:n, n:f], joint[n:f, :n], joint[n:f, n:f] = cross, cross.T, Q
        ends = np.cumsum([*(len(m.value) for m in used), 1])
        rows = [np.arange(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True)]
        innovation, spread, log_p = [], [], []
        for k in rows:
            root = np.linalg.cholesky(noise[np.ix_(k, k)])
            share, axes = np.linalg.eigh(root.T @ M[np.ix_(k, k)] @ root)
            checked = share > UNCHECKED
            # Directions that nothing else determines have no innovation.
            inverse = np.where(checked, 1 / np.where(checked, share, 1), np.nan)
            white = axes.T @ root.T @ error[k]
            squared = np.nansum(inverse * white**2)
            log_p.append(scipy.stats.chi2.logsf(squared, checked.sum()) if checked.any() else 0.0)
            innovation.append(root @ axes @ (inverse * white))
            spread.append(root @ axes @ (inverse[:, None] * axes.T) @ root.T)
        return _Fit(at, place, joint, innovation, spread, np.array(log_p), float(off @ error))


def _consistent(problem: _Problem, least: float) -> tuple[Bool[np.ndarray, " m"], bool]:
    """Set aside what contradicts the others, one by one, until nothing does.

    Of all that contradict, the one without which the others agree best is set aside; the height of
    the crowd before a measurement that would do as well. What agrees again afterwards returns once.

    Args:
        problem: everything that is measured.
        least: log probability below which a difference is a contradiction.

    Returns:
        The (m,) measurements to use, and whether the crowd's height is as usual.

    Raises:
        CalibrationError: if the map frame is not determined by what remains.
    """
    count = len(problem.usable)
    chosen, typical, returned = np.ones(count, bool), True, np.zeros(count, bool)
    while True:
        fit = problem.fit(chosen, typical=typical)
        index = np.append(np.flatnonzero(chosen), count)
        against = index[fit.log_p < least]
        if not typical:
            against = against[against < count]
        if len(against):
            left = [problem.misfit_without(chosen, int(at), typical=typical) for at in against]
            if np.isinf(left).all():
                raise CalibrationError(
                    "The anchors on the map contradict the people and each other; check their "
                    "units, the order of x and y, and whether x, y and up are right-handed."
                )
            best = min(left)
            same = against[np.array(left) <= (1 + SAME) * best + SAME]
            if same[-1] == count:
                typical = False
            else:
                chosen[same[0]], typical = False, True
            continue
        outside = np.flatnonzero(~chosen & ~returned)
        again = [at for at in outside if _unused(problem.usable[at], fit)[2] >= least]
        if not again:
            return chosen, typical
        chosen[again[0]] = returned[again[0]] = True


def _parameters(rig: Rig) -> Float[np.ndarray, "cam 7"]:
    """Parameters of registered cameras, 0 for the others."""
    known = np.asarray(rig.registered)[:, None]
    return np.where(known, of_rig(rig), 0.0)


def _prior(calibration: Calibration) -> Float[np.ndarray, "n n"]:
    """(7C, 7C) covariance of the cameras, vague where it is unknown."""
    covariance = calibration.camera_covariance
    count = len(covariance)
    covariance = covariance.reshape(7 * count, 7 * count)
    known = np.isfinite(np.diag(covariance))
    return np.where(known & known[:, None], covariance, np.diag(np.where(known, 0.0, 1.0)))


def _require_ground(
    usable: Sequence[Measurement],
    cameras: Float[np.ndarray, "cam 7"],
    names: Sequence[str],
) -> None:
    """Refuse pixels through which no ground is seen.

    Raises:
        InvalidInputError: naming the camera.
    """
    for m in usable:
        if m.kind not in (DISTANCE, POINT):
            continue
        K, R, _ = to_matrices(cameras[m.camera][None], np.ones((1, 2), int))
        ray = (m.pixels / K[0, 0, 0]) @ R[0, :2] + R[0, 2]
        if (ray[:, 2] > -FLATTEST * np.linalg.norm(ray, axis=1)).any():
            raise InvalidInputError(
                f"{_name(m, names)} has a pixel at or above the horizon; an anchor needs points on "
                "the ground."
            )


def _start(usable: Sequence[Measurement], cameras: Float[np.ndarray, "cam 7"]) -> _Frame:
    """The map frame that fits best without regard to deviations.

    Its last three entries stay 0 and fixed unless anchors on a map determine them.
    """
    on = [m for m in usable if m.kind in (POSITION, POINT)]
    turned = [m for m in usable if m.kind == ROTATION]
    identity = np.zeros(4)
    places = np.array([m.value[:2] for m in on]).reshape(-1, 2)
    distinct = len(np.unique(places, axis=0))
    if distinct < 1 or distinct + bool(turned) < 2:
        return _Frame(identity, 1)
    points = linearize(on, cameras, identity).value[:, :2]
    if distinct > 1:
        # Over complex numbers a rotation times a scale is one factor.
        near, far = ((xy - xy.mean(0)) @ np.array([1, 1j]) for xy in (points, places))
        factor = (near.conj() @ far) / max((near.conj() @ near).real, 1e-12)
        scale, angle = max(abs(factor), 1e-3), float(np.angle(factor))
    else:
        scale, angle = 1.0, float(turned[0].value[2] - cameras[turned[0].camera, PAN])
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    shift = (places - points @ np.array([[c, s], [-s, c]])).mean(0)
    return _Frame(np.array([np.log(scale), angle, *shift]), 4)


class _Equations(NamedTuple):
    """Measurements linearized at a rig and a map frame, the crowd's height last.

    Attributes:
        by_camera: (k, 7C) derivatives by the cameras.
        by_frame: (k, f) by the free entries of the map frame.
        noise: (k, k) covariance of what is stated.
        off: (k,) stated minus predicted for the cameras from the people.
    """

    by_camera: Float[np.ndarray, "k n"]
    by_frame: Float[np.ndarray, "k f"]
    noise: Float[np.ndarray, "k k"]
    off: Float[np.ndarray, " k"]

    @classmethod
    def of(
        cls,
        chosen: Sequence[Measurement],
        cameras: Float[np.ndarray, "cam 7"],
        at: Float[np.ndarray, "cam 7"],
        place: Float[np.ndarray, "4"],
        free: int,
        crowd: float,
    ) -> "_Equations":
        """Linearize at cameras `at` and the map frame `place`."""
        size = sum(len(m.value) for m in chosen) + 1
        by_camera, by_frame = np.zeros((size, cameras.size)), np.zeros((size, 4))
        noise, off = np.zeros((size, size)), np.zeros(size)
        by_frame[-1, 0], noise[-1, -1], off[-1] = 1.0, crowd**2, -place[0]
        linear, start = linearize(chosen, at, place), 0
        for i, m in enumerate(chosen):
            d, k = len(m.value), np.arange(start, start + len(m.value))
            by_camera[k, 7 * m.camera : 7 * m.camera + 7] = linear.by_camera[i, :d]
            by_frame[k] = linear.by_frame[i, :d]
            noise[np.ix_(k, k)] = _noise(m, linear.by_pixel[i, :d])
            off[k] = _turned(m.value - linear.value[i, :d], m.kind)
            start += d
        off += by_camera @ (at - cameras).ravel()
        return cls(by_camera, by_frame[:, :free], noise, off)

    def inverses(
        self, prior: Float[np.ndarray, "n n"]
    ) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "f f"], Float[np.ndarray, "k k"]]:
        """Information of what is stated, covariance of the map frame, and the information left."""
        W = np.linalg.inv(self.by_camera @ prior @ self.by_camera.T + self.noise)
        WG = W @ self.by_frame
        Q = np.linalg.inv(self.by_frame.T @ WG)
        return W, Q, W - WG @ Q @ WG.T

    def solve(
        self, prior: Float[np.ndarray, "n n"]
    ) -> tuple[Float[np.ndarray, "cam 7"], Float[np.ndarray, " f"]]:
        """Move of the cameras from those of the people, and step of the map frame."""
        W, Q, M = self.inverses(prior)
        moved = prior @ self.by_camera.T @ M @ self.off
        return moved.reshape(-1, 7), Q @ self.by_frame.T @ W @ self.off


def _unused(
    measurement: Measurement, fit: _Fit
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d d"], float]:
    """Innovation, its covariance and its log probability for a measurement outside a fit."""
    size, at = len(measurement.value), 7 * measurement.camera
    linear = linearize([measurement], fit.cameras, fit.frame)
    J = np.zeros((size, len(fit.covariance)))
    J[:, at : at + 7], J[:, -4:] = linear.by_camera[0, :size], linear.by_frame[0, :size]
    by_pixel = linear.by_pixel[0, :size]
    off = _turned(measurement.value - linear.value[0, :size], measurement.kind)
    spread = J @ fit.covariance @ J.T + _noise(measurement, by_pixel)
    return off, spread, float(scipy.stats.chi2.logsf(off @ np.linalg.solve(spread, off), size))


def _noise(
    measurement: Measurement, by_pixel: Float[np.ndarray, "d 4"]
) -> Float[np.ndarray, "d d"]:
    """Covariance of a stated quantity, with that of its pixels."""
    return np.diag(measurement.sd**2) + measurement.pixel_sd**2 * by_pixel @ by_pixel.T


def _turned(off: Float[np.ndarray, " d"], kind: int) -> Float[np.ndarray, " d"]:
    """Differences of angles modulo a whole turn; other differences as they are."""
    return (off + np.pi) % (2 * np.pi) - np.pi if kind == ROTATION else off


def _check(
    measurement: Measurement,
    anchor: Anchor,
    innovation: Float[np.ndarray, " d"],
    spread: Float[np.ndarray, "d d"],
    log_p: float,
    names: Sequence[str],
    *,
    used: bool,
) -> AnchorCheck:
    """Compare one stated quantity with what everything else says about it."""
    kind, value = measurement.kind, measurement.value
    sd = np.sqrt(np.diag(spread))
    about, unit = _name(measurement, names), "px" if kind == FOCAL else "m"
    if kind in LOGARITHMS:
        stated, other = np.exp(value), np.exp(value - innovation)
        difference, sd = stated - other, other * sd
        what = f"is {_number(other[0], unit)} {unit} (sd {_number(sd[0], unit)} {unit})"
    else:
        factor, unit = (np.rad2deg(1.0), "degrees") if kind == ROTATION else (1.0, "m")
        difference, sd = factor * innovation, factor * sd
        what = (
            f"is off by {np.linalg.norm(difference):.2f} {unit} "
            f"(sd {np.sqrt((sd**2).sum()):.2f} {unit})"
        )
    if np.isnan(difference).all():
        sentence = f"{about} cannot be checked: nothing else determines it."
    else:
        sentence = f"{about} {what} by the people and the other anchors"
        sentence += "." if used else ": it contradicts them and was not used."
    return AnchorCheck(
        anchor,
        QUANTITIES[kind],
        tuple(difference.tolist()),
        tuple(sd.tolist()),
        float(np.exp(log_p)),
        used,
        sentence,
    )


def _check_of_crowd(
    calibration: Calibration, innovation: float, variance: float, log_p: float, *, used: bool
) -> AnchorCheck:
    """Compare the expected height of the people with what the anchors say about it."""
    height, expected_sd = calibration.crowd_height, calibration.crowd_height_sd
    other = height * np.exp(-innovation)
    expected = f"{height:.2f} m (sd {expected_sd:.2f} m)"
    if np.isnan(other):
        sentence = f"No anchor tells how tall the people are; {expected} on average is assumed."
    else:
        sentence = f"By the anchors the people are {other:.2f} m tall on average"
        sentence += (
            f"; {expected} was expected."
            if used
            else f", but {expected} was expected, so that their height is not used: they are not "
            "the usual adults, or an anchor is wrong."
        )
    sd = float(other * np.sqrt(variance))
    difference = float(height - other)
    return AnchorCheck(None, "people", (difference,), (sd,), float(np.exp(log_p)), used, sentence)


def _name(measurement: Measurement, names: Sequence[str]) -> str:
    """Name a stated quantity at the beginning of a sentence."""
    kind, value = measurement.kind, measurement.value
    camera = shortened(names[measurement.camera])
    if kind == DISTANCE:
        return f"The distance of {np.exp(value[0]):.2f} m in camera {camera}"
    if kind in (HEIGHT, FOCAL):
        stated = f"{np.exp(value[0]):.2f} m" if kind == HEIGHT else f"{np.exp(value[0]):.0f} px"
        return f"The {QUANTITIES[kind]} of {stated} of camera {camera}"
    if kind == POINT:
        return f"The point ({value[0]:.2f}, {value[1]:.2f}) in camera {camera}"
    return f"The {QUANTITIES[kind]} of camera {camera}"


def _number(value: float, unit: str) -> str:
    return f"{value:.0f}" if unit == "px" else f"{value:.2f}"


def _described(
    calibration: Calibration,
    fit: _Fit,
    checks: tuple[AnchorCheck, ...],
    earth: GeoReference | None,
) -> Calibration:
    """The calibration of the fitted cameras in the frame of the anchors."""
    rig, count = calibration.scene.rig, len(fit.cameras)
    known = np.asarray(rig.registered)
    cameras, J = map_cameras(fit.cameras, fit.frame)
    covariance = (J @ fit.covariance @ J.T).reshape(count, 7, count, 7)
    _, R, t = to_matrices(cameras, np.asarray(rig.image_size))
    K = np.array(rig.K, np.float64)
    focal = np.exp(cameras[:, LOG_FOCAL])
    ratio = np.where(known, focal / K[:, 0, 0], 1.0)
    K[:, :2, :2] *= ratio[:, None, None]
    distortion = rig.distortion
    if distortion is not None:  # the bend in pixels stays
        distortion = np.array(distortion, np.float64)
        distortion[:, 0] *= ratio**2
    rig = replace(
        rig,
        K=K,
        distortion=distortion,
        R=np.where(known[:, None, None], R, np.asarray(rig.R)),
        t=np.where(known[:, None], t, np.asarray(rig.t)),
    )
    scene = Scene.from_rig(rig, calibration.scene.ground, metric=True)
    blocks = covariance[np.arange(count), :, np.arange(count)]
    scale = float(np.exp(fit.frame[0]))
    relative = np.sqrt(fit.covariance[-4, -4])
    return replace(
        calibration,
        scene=replace(
            scene, georeference=earth, rig_sd=shape_deviation(cameras, covariance, known)
        ),
        focal_sd=np.where(known, focal * np.sqrt(blocks[:, LOG_FOCAL, LOG_FOCAL]), np.nan),
        center_covariance=np.where(known[:, None, None], blocks[:, X:, X:], np.nan),
        camera_covariance=covariance,
        scale_sd=float(np.sqrt(scale_variance(cameras, covariance, known))),
        crowd_height=calibration.crowd_height * scale,
        crowd_height_sd=float(calibration.crowd_height * scale * relative),
        foot_offset=calibration.foot_offset * scale,
        anchors=checks,
    )
