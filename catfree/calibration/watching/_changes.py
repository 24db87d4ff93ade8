"""Times at which a camera turned or its clock jumped: a linear model of all cameras over time.

The costs of the windows are quadratic. Errors that are constant, grow with time or begin at a
window therefore form one linear model, and the evidence for one more change has a closed form.
Every person has a bias of their own, so the scatter between people reveals the true noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import fdtrc

from catfree.calibration.watching._agreement import Window, prior
from catfree.calibration.watching._sights import LAG, LAGS, PARAMETERS, TURN

KINDS = (TURN, LAG)
REPEATS = (3, 1, PARAMETERS - 4)  # parameters of the turn, the lag and the rest
POOLED = 8.0  # degrees of freedom of the pooled noise, the prior of each camera's
HELD = 1e8  # factor on the information of the prior on centers and focal lengths
FEWEST_WINDOWS = 4  # fewer cannot show a change
# Errors that do not average out over people: local distortion of the map, gait.
FLOORS = np.deg2rad(0.05) ** 2, 0.03**2  # variances of a turn and a lag
MOST_CHANGES = 3  # per camera and kind
LOST = 0.3  # of the usual share of matches; with less, a camera does not show these people


class Change(NamedTuple):
    """A camera's error that begins at a window.

    Attributes:
        camera: index of the camera.
        kind: `TURN` or `LAG`, the parameters that changed.
        window: the first window after the change.
    """

    camera: int
    kind: slice
    window: int


def columns_of(camera: int, kind: slice) -> slice:
    """Positions of the parameters of one camera and kind among those of all cameras."""
    return slice(PARAMETERS * camera + kind.start, PARAMETERS * camera + kind.stop)


@dataclass(frozen=True)
class Course:
    """The errors of all cameras over time.

    Attributes:
        windows: the fitted windows.
        changes: the changes found.
        design: (W, 8C, q) map from `value` to the errors of all cameras in each window.
        value: (q,) constant errors (8C), clock rates (C), then the changes.
        covariance: covariance of `value`, without the factor `noise`.
        matrix: (W, 8C, 8C) information of each window on the errors.
        rest: (W, 8C) remaining gradient of the log likelihood of each window.
        reference: the camera to which lags are relative, before its changes: the one whose lags are
            nearest to those of all others over the recording.
        noise: (C, 2) factor by which variances of turns and lags exceed those of box noise alone.
        freedom: (C, 2) degrees of freedom of `noise`.
    """

    windows: Sequence[Window]
    changes: tuple[Change, ...]
    design: Float[np.ndarray, "w p q"]
    value: Float[np.ndarray, " q"]
    covariance: Float[np.ndarray, "q q"]
    matrix: Float[np.ndarray, "w p p"]
    rest: Float[np.ndarray, "w p"]
    reference: int
    noise: Float[np.ndarray, "cam 2"]
    freedom: Float[np.ndarray, "cam 2"]

    def at(
        self, window: int, changed: int | None = None
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
        """Errors of all cameras in a window, and their covariance with the factor `noise`.

        Args:
            window: index of the window.
            changed: another window whose changes should apply, if any.
        """
        design, constant = self.design[window].copy(), (PARAMETERS + 1) * len(self.noise)
        if changed is not None:
            design[:, constant:] = self.design[changed, :, constant:]
        return self._errors(design)

    def rates(self) -> tuple[Float[np.ndarray, " cam"], Float[np.ndarray, "cam cam"]]:
        """Growth rate of each clock's lag in steps per step, and the covariance."""
        p = PARAMETERS * len(self.noise)
        design = np.zeros((p, len(self.value)))
        design[LAGS, p : p + len(self.noise)] = np.eye(len(self.noise))
        value, covariance = self._errors(design, floor=False)
        return value[LAGS], covariance[LAGS, LAGS]

    def constant(self) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
        """Errors of all cameras in the middle of the recording, without the changes."""
        design = np.eye(PARAMETERS * len(self.noise), len(self.value))
        return self._errors(design)

    def _errors(
        self, design: Float[np.ndarray, "p q"], *, floor: bool = True
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
        """Errors that a design selects: lags relative to the reference before its changes."""
        design, zero = design.copy(), design[PARAMETERS * self.reference + 3].copy()
        zero[(PARAMETERS + 1) * len(self.noise) :] = 0
        design[LAGS] -= zero
        factor = np.sqrt(np.repeat(self.noise[:, [0, 1, 0]], REPEATS, axis=1)).ravel()
        covariance = design @ self.covariance @ design.T * factor[:, None] * factor
        if floor:
            floors = np.tile(np.repeat([*FLOORS, 0.0], REPEATS), len(self.noise))
            covariance = covariance + np.diag(floors)
        return design @ self.value, covariance

    def of_changes(
        self, indices: Sequence[int]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
        """Sum the changes of one camera and kind; return the sum and its covariance."""
        camera, kind, _ = self.changes[indices[0]]
        which = KINDS.index(kind)
        begins = np.array([self.changes[index].window for index in indices])
        design = (self.design[begins] - self.design[begins - 1]).sum(0)[columns_of(camera, kind)]
        design[:, : (PARAMETERS + 1) * len(self.noise)] = 0  # without constant and growing errors
        covariance = self.noise[camera, which] * design @ self.covariance @ design.T
        return design @ self.value, covariance + FLOORS[which] * np.eye(len(design))


def fit_course(
    windows: Sequence[Window],
    alpha: float,
    *,
    kinds: Sequence[slice] = KINDS,
    first: int = 1,
) -> Course:
    """Fit constant errors and as many changes as the windows support.

    Args:
        windows: windows of the whole recording, in order.
        alpha: probability of a false change at any one window.
        kinds: `TURN`, `LAG` or both: what may change.
        first: first window at which a change may begin.
    """
    course = _fitted((), windows)
    cameras = len(course.noise)
    while len(course.changes) < MOST_CHANGES * cameras:
        candidates = [
            _strongest(course, camera, kind, first)
            for camera in range(cameras)
            for kind in kinds
            if sum(c.camera == camera and c.kind == kind for c in course.changes) < MOST_CHANGES
        ]
        chance, change = min(candidates, default=(1.0, None), key=lambda item: item[0])
        if change is None or chance > alpha:
            break
        course = _fitted((*course.changes, change), windows)
    return course


def as_turns(course: Course) -> Course:
    """Fit the same changes with centers and focal lengths held, so that turns explain the rest.

    A constant turn and a constant displacement of a camera look nearly the same.
    """
    return _fitted(course.changes, course.windows, held=True)


def _fitted(
    changes: tuple[Change, ...], windows: Sequence[Window], *, held: bool = False
) -> Course:
    """Solve for the errors of all cameras with these changes, and learn the noise."""
    matrix = np.array([window.matrix.sum(0) for window in windows])
    vector = np.array([window.vector.sum(0) for window in windows])
    constant = matrix.shape[1]
    cameras = constant // PARAMETERS
    every = np.eye(constant)
    middle = np.array([(w.begin + w.stop) / 2 for w in windows])
    time = middle - middle.mean()
    window = np.arange(len(windows))[:, None, None]
    design = np.concatenate(
        [
            np.broadcast_to(every, matrix.shape),
            time[:, None, None] * every[:, LAGS],
            *((window >= begin) * every[:, columns_of(c, kind)] for c, kind, begin in changes),
        ],
        axis=2,
    )
    weak = np.zeros((design.shape[2],) * 2)
    weak[:constant, :constant] = prior(cameras)
    if held:
        still = np.flatnonzero(np.arange(constant) % PARAMETERS >= 4)
        weak[still, still] *= HELD
    extra = np.arange(constant, len(weak))
    # Rates, and changes that no person shows, are zero.
    scale = max(1.0, float(np.abs(time).max()))
    weak[extra, extra] = 1e-2
    clocks = extra[:cameras]
    weak[clocks, clocks] = 1e-2 * scale**2
    total = weak + sum(X.T @ A @ X for X, A in zip(design, matrix, strict=True))
    right = sum(X.T @ b for X, b in zip(design, vector, strict=True))
    covariance = np.linalg.inv(total)
    value = covariance @ right
    noise, freedom = _noise(design @ value, windows)
    timed = np.flatnonzero(matrix.sum(0).diagonal()[LAGS] > 0)
    lags = (design @ value)[:, LAGS][:, timed]
    apart = np.abs(lags[..., None] - lags[:, None]).sum((0, 1))
    reference = int(timed[apart.argmin()]) if len(timed) else 0
    rest = vector - np.einsum("wij,wj->wi", matrix, design @ value)
    return Course(
        windows, changes, design, value, covariance, matrix, rest, reference, noise, freedom
    )


def _noise(
    errors: Float[np.ndarray, "w p"], windows: Sequence[Window]
) -> tuple[Float[np.ndarray, "cam 2"], Float[np.ndarray, "cam 2"]]:
    """Estimate the excess scatter of people over box noise, and its degrees of freedom.

    Every person has a bias of their own, in all of their boxes. A camera whose people say little
    about it gets the estimate of all cameras, or 1 if those say little, too.
    """
    cameras = errors.shape[1] // PARAMETERS
    squared, expected = np.zeros((2, cameras, len(KINDS)))
    for window, error in zip(windows, errors, strict=True):
        rest = window.vector - window.matrix @ error
        for camera in range(cameras):
            for which, kind in enumerate(KINDS):
                columns = columns_of(camera, kind)
                scatter = _scatter(rest[:, columns], window.matrix[:, columns, columns])
                squared[camera, which] += scatter[0]
                expected[camera, which] += scatter[1]
    pooled = (squared.sum(0) + POOLED) / (expected.sum(0) + POOLED)
    freedom = expected + POOLED
    return np.maximum((squared + POOLED * pooled) / freedom, 1.0), freedom


def _scatter(
    score: Float[np.ndarray, "group k"], information: Float[np.ndarray, "group k k"]
) -> tuple[float, float]:
    """Squared differences of people from their mean, and the value expected from box noise alone.

    Args:
        score: gradient of each person's cost by an error of a camera.
        information: curvature of this cost.
    """
    total = information.sum(0)
    if not total.trace() > 0 or np.linalg.cond(total) > 1e8:
        return 0.0, 0.0
    share = np.linalg.solve(total, information)
    mean = np.linalg.solve(total, score.sum(0))
    rest = score - information @ mean
    squared = np.einsum("gi,ij,gj->", rest, np.linalg.inv(total), rest)
    return float(squared), float(len(total) - np.einsum("gij,gji->", share, share))


def _strongest(course: Course, camera: int, kind: slice, first: int) -> tuple[float, Change | None]:
    """Find the most likely further change of one camera, and its probability by chance."""
    best: tuple[float, Change | None] = (1.0, None)
    if len(course.windows) < FEWEST_WINDOWS:
        return best
    columns = columns_of(camera, kind)
    size, which = columns.stop - columns.start, KINDS.index(kind)
    score, information = course.rest[:, columns], course.matrix[:, columns, columns]
    noise, freedom = course.noise[camera, which], course.freedom[camera, which]
    # Information that a change shares with what is already in the model.
    shared = course.matrix[:, columns] @ course.design
    for window in range(first, len(course.windows)):
        candidate = Change(camera, kind, window)
        if candidate in course.changes:
            continue
        cross = shared[window:].sum(0)
        left = information[window:].sum(0) - cross @ course.covariance @ cross.T
        left = (left + left.T) / 2
        values, vectors = np.linalg.eigh(left)
        if values[-1] <= 0:
            continue
        # A direction in which nobody shows the change has no evidence.
        informative = values > 1e-9 * values[-1]
        inverse = (vectors[:, informative] / values[informative]) @ vectors[:, informative].T
        change = inverse @ score[window:].sum(0)
        covariance = noise * (inverse + 1e-12 * np.eye(size)) + FLOORS[which] * np.eye(size)
        squared = float(change @ np.linalg.solve(covariance, change))
        chance = float(fdtrc(size, freedom, squared / size))
        if chance < best[0]:
            best = chance, candidate
    return best


def lost_since(
    matched: Int[np.ndarray, " w"],
    expected: Int[np.ndarray, " w"],
    distinct: Int[np.ndarray, " w"],
    usual: float,
    alpha: float,
) -> int | None:
    """Find the first window from which a camera shows none of the people that it should, or None.

    Args:
        matched: (W,) people matched with a box of the camera.
        expected: (W,) people who should be in its image.
        distinct: (W,) distinct people among them; each counts as one draw.
        usual: share of people matched when all is well.
        alpha: probability of a false alarm.
    """
    lost: Bool[np.ndarray, " w"] = matched < LOST * usual * expected
    begin = None
    chance = 0.0
    for window in range(len(lost))[::-1]:
        if expected[window] == 0:
            continue
        if not lost[window]:
            break
        begin = window
        chance += distinct[window] * np.log1p(-min(usual, 0.95) * (1 - LOST))
    return begin if chance < np.log(alpha) else None
