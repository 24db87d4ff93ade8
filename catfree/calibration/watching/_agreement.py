"""Disagreement of the cameras: turns and lags of all cameras, with the people eliminated.

Every person's place is unknown in every frame. With it eliminated, each person seen by two or more
cameras leaves a quadratic cost of these cameras' turns and lags. Costs add up over people and over
time, so the errors of a camera in a window, since a window, or throughout follow from sums of the
same matrices. Centers and focal lengths of the cameras have constant errors within the usual
deviations of a rig. They are unknowns, too, so that people who walk to other places do not look
like a turning camera.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.calibration.watching._matching import (
    BoxMatches,
    best,
    candidates,
    corrected_place,
    match_boxes,
    whole_steps,
)
from catfree.calibration.watching._sights import CENTER, LAG, PARAMETERS, TURN, Sights, linear
from catfree.geometry._least_squares import CAUCHY

ROUNDS = 3  # of matching and solving
REWEIGHTED = 2  # solutions per round
HEIGHT_SD = 0.1  # of a person's height relative to that of the track
TURN_SD, LAG_SD = np.deg2rad(20.0), 30.0  # weak priors for errors that no person constrains
CENTER_SD, FOCAL_SD = 0.15, 0.03  # for a rig from people or reconstructions
LARGEST_STEP = np.deg2rad(5.0)  # of a turn per solution
FARTHEST = 1.0  # person heights; largest correction of a place at a time


class Window(NamedTuple):
    """Information from one window of time on the cameras' errors.

    Attributes:
        begin: first step.
        stop: step after the last one.
        matrix: (G, 8C, 8C) information of each person (group) on the errors of all cameras.
        vector: (G, 8C) matrix times errors: the sums over G are solved for the errors.
        counts: (4, C) people matched with a box, people who should be in the image, distinct people
            among the latter, and boxes.
        errors: (C, 8) of the cameras, from the boxes of this window.
    """

    begin: int
    stop: int
    matrix: Float[np.ndarray, "group p p"]
    vector: Float[np.ndarray, "group p"]
    counts: Int[np.ndarray, "4 cam"]
    errors: Float[np.ndarray, "cam 8"]


def prior(cameras: int) -> Float[np.ndarray, "p p"]:
    """Information of the weak priors of all cameras."""
    deviation = [TURN_SD] * 3 + [LAG_SD] + [CENTER_SD] * 3 + [FOCAL_SD]
    return np.diag(np.tile(np.array(deviation) ** -2.0, cameras))


def solve_window(
    sights: Sights,
    begin: int,
    stop: int,
    start: Float[np.ndarray, "cam 8"],
    shifts: Int[np.ndarray, " s"] | None = None,
) -> Window:
    """Match everybody in a window, and sum the information on the cameras' errors.

    Args:
        sights: the recording.
        begin: first step.
        stop: step after the last one.
        start: (C, 8) errors of the cameras to begin with.
        shifts: lags to try, in steps; None to trust `start`.
    """
    people, count = sights.people, len(sights.place)
    person = people.between(begin, stop)
    errors = start.copy()
    registered = np.flatnonzero(sights.scene.rig.registered)
    present = (sights.boxes.frame >= begin) & (sights.boxes.frame < stop)
    boxes = np.bincount(sights.boxes.camera[present], minlength=count)
    if shifts is not None:
        for camera in np.flatnonzero(boxes).tolist():
            others = people.seen_by_others(camera, person)
            tried = candidates(sights, camera, others, shifts)
            errors[camera] = best(sights, camera, others, errors[camera], tried)
    begun = errors.ravel()
    solved = _solve(sights, person, people.state[person], errors, begun)
    for _ in range(ROUNDS - 1):
        solved = _solve(sights, person, solved.state, solved.errors, begun)
    counts = np.zeros((4, count), np.int64)
    counts[3] = boxes
    for camera, found in zip(registered.tolist(), solved.matches, strict=True):
        # A camera's own boxes do not make a person expected in it.
        others = people.seen_by_others(camera, found.expected)
        matched, distinct = np.isin(found.person, others).sum(), np.unique(people.track[others])
        counts[:3, camera] = matched, len(others), len(distinct)
    return Window(begin, stop, *solved.of_tracks(people.track[person]), counts, solved.errors)


class _Equations(NamedTuple):
    """Normal equations of each person: cameras' errors, and the terms that eliminate the place.

    Attributes:
        per_camera: (M, C, 8, 8) matrix of each camera's errors.
        right: (M, C, 8) right-hand side.
        mixed: (M, 3, 8C) cross terms of place and height with the errors.
        solution: (M, 3, 8C + 1) solution of the place's equations for `mixed` and its right-hand
            side.
    """

    per_camera: Float[np.ndarray, "m cam 8 8"]
    right: Float[np.ndarray, "m cam 8"]
    mixed: Float[np.ndarray, "m 3 p"]
    solution: Float[np.ndarray, "m 3 q"]

    @classmethod
    def of(
        cls,
        slope: Float[np.ndarray, "m cam 3 k"],
        residual: Float[np.ndarray, "m cam 3"],
        precision: Float[np.ndarray, "m cam 3"],
        held: Float[np.ndarray, " m"],
        pull: Float[np.ndarray, " m"],
    ) -> "_Equations":
        """Build them from linearized boxes.

        Args:
            slope: derivatives of the angles of each box by its camera's errors, place and height
                (all lengths in person heights).
            residual: measured minus predicted angles.
            precision: of the residuals, 0 where there is no box.
            held: precision of the prior of each height.
            pull: `held` times (prior minus current height).
        """
        m, count = residual.shape[:2]
        errors, place = slice(0, PARAMETERS), slice(PARAMETERS, None)
        weighted = slope * precision[..., None]
        normal = weighted.swapaxes(-1, -2) @ slope
        right = np.einsum("mcei,mce->mci", weighted, residual)
        block = normal[..., place, place].sum(1) + 1e-9 * np.eye(3)
        block[:, 2, 2] += held
        aim = right[..., place].sum(1)
        aim[:, 2] += pull
        mixed = normal[..., place, errors].swapaxes(1, 2).reshape(m, 3, PARAMETERS * count)
        solution = np.linalg.inv(block) @ np.concatenate([mixed, aim[..., None]], 2)
        return cls(normal[..., errors, errors], right[..., errors], mixed, solution)

    def sums(self, rows) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
        """Sum the matrices and vectors of some people for the errors, with places eliminated."""
        mixed, solution = self.mixed[rows], self.solution[rows]
        p, cameras = mixed.shape[-1], np.arange(self.per_camera.shape[1])
        matrix = -mixed.reshape(-1, p).T @ solution.reshape(-1, p + 1)
        matrix[:, p] += self.right[rows].sum(0).ravel()
        view = matrix[:, :p].reshape(len(cameras), PARAMETERS, len(cameras), PARAMETERS)
        view[cameras, :, cameras] += self.per_camera[rows].sum(0)
        return matrix[:, :p], matrix[:, p]


class _Solved(NamedTuple):
    """One round of matching and solving.

    Attributes:
        matches: matches of each registered camera.
        used: (M,) whether two or more cameras see the person.
        equations: equations of all people, linearized at the `present` errors.
        present: (C, 8) errors before the round.
        errors: (C, 8) errors after it.
        state: (M, 3) places and heights after it.
    """

    matches: list[BoxMatches]
    used: Bool[np.ndarray, " m"]
    equations: _Equations
    present: Float[np.ndarray, "cam 8"]
    errors: Float[np.ndarray, "cam 8"]
    state: Float[np.ndarray, "m 3"]

    def of_tracks(
        self, track: Int[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "group p p"], Float[np.ndarray, "group p"]]:
        """Matrix and vector of a `Window`, given the track of each person."""
        theta, kept = self.present.ravel(), np.flatnonzero(self.used)
        tracks, p = np.unique(track[kept]), len(theta)
        matrix, vector = np.zeros((len(tracks), p, p)), np.zeros((len(tracks), p))
        for g, one in enumerate(tracks):
            matrix[g], vector[g] = self.equations.sums(kept[track[kept] == one])
        return matrix, vector + matrix @ theta


def _solve(
    sights: Sights,
    person: Int[np.ndarray, " m"],
    state: Float[np.ndarray, "m 3"],
    present: Float[np.ndarray, "cam 8"],
    begun: Float[np.ndarray, " p"],
) -> _Solved:
    """Match with the present errors and places, linearize, and solve with robust weights.

    Errors that no person constrains keep their values from `begun`.
    """
    people, boxes, count = sights.people, sights.boxes, len(sights.place)
    registered = np.flatnonzero(sights.scene.rig.registered)
    matches = match_boxes(sights, person, state, registered, present[registered])
    m, p = len(person), PARAMETERS * count
    errors, quick = slice(0, PARAMETERS), np.flatnonzero(np.arange(p) % PARAMETERS < 4)
    residual = np.zeros((m, count, 3))
    slope = np.zeros((m, count, 3, PARAMETERS + 3))
    precision = np.zeros((m, count, 3))
    shown = np.concatenate([one.person for one in matches])
    box = np.concatenate([one.box for one in matches])
    camera = boxes.camera[box]
    row, velocity = np.searchsorted(person, shown), people.velocity[shown]
    rest = present[:, LAG] - whole_steps(present)
    moved = state[row]
    moved[:, :2] -= rest[camera] * velocity
    place = corrected_place(sights, np.arange(count), present)
    value, slopes = linear(moved, velocity, place[camera])
    slopes[..., CENTER] *= sights.unit
    slopes[..., PARAMETERS:] *= sights.unit  # so that the unit of length does not matter
    slope[row, camera], residual[row, camera] = slopes, boxes.angle[box] - value
    precision[row, camera] = np.where(boxes.whole[box], boxes.deviation[box] ** -2.0, 0.0)
    used = (precision[..., 0] > 0).sum(-1) >= 2
    precision *= used[:, None, None]
    tall = people.state[person, 2] / sights.unit
    held = (HEIGHT_SD * tall) ** -2.0
    theta, known = present.ravel(), prior(count)
    pull = held * (tall - state[:, 2] / sights.unit)
    equations = _Equations.of(slope, residual, precision, held, pull)
    step, shift = np.zeros(p), np.zeros((m, 3))
    for again in range(REWEIGHTED):
        if again:
            turned = np.einsum("mcei,ci->mce", slope[..., errors], step.reshape(count, PARAMETERS))
            moved = np.einsum("mcei,mi->mce", slope[..., PARAMETERS:], shift)
            weight = 1 / (1 + (residual - turned - moved) ** 2 * precision / CAUCHY**2)
            equations = _Equations.of(slope, residual, precision * weight, held, pull)
        # A window alone determines only turns and lags; matching needs no more.
        matrix, vector = equations.sums(slice(None))
        needed = (vector - known @ (theta - begun))[quick]
        step[quick] = np.linalg.solve((matrix + known)[np.ix_(quick, quick)], needed)
        shift = equations.solution[..., p] - equations.solution[..., :p] @ step
    step = step.reshape(count, PARAMETERS)
    step[:, TURN] = np.clip(step[:, TURN], -LARGEST_STEP, LARGEST_STEP)
    placed = state + sights.unit * np.clip(shift, -FARTHEST, FARTHEST)
    return _Solved(matches, used, equations, present, present + step, placed)
