"""Matching of one camera's boxes with the people seen by others, even if it turned or lags."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import correlate
from scipy.spatial.transform import Rotation

from catfree.calibration.watching._sights import (
    CENTER,
    LAG,
    PARAMETERS,
    TURN,
    ZOOM,
    SightedBoxes,
    Sights,
    predicted,
)
from catfree.types._sampling import equal_pairs, mutually_lowest

SPREAD = 0.12  # of a box height; standard deviation of a box from its person
GATE = 3.0  # deviations; the largest distance of a match
ALIKE = 0.35  # natural log; the largest ratio of box and person heights in a vote
CELL = np.deg2rad(1.0)  # side of a cell of the vote
REACH = 15  # cells; the largest turn searched for
TRIED = 4  # peaks of a vote to try
BETTER = 1.25  # factor on the present number of matches needed to accept a peak
FEWEST = 6  # additional matches needed to accept a peak


class BoxMatches(NamedTuple):
    """Boxes of one camera matched with people.

    Attributes:
        person: (k,) index of the person.
        box: (k,) index of the box.
        angle: (k, 3) predicted angles.
        score: number of matches, each weighted less the closer it is to the gate.
        expected: (e,) people who should be in an image of the recording.
    """

    person: Int[np.ndarray, " k"]
    box: Int[np.ndarray, " k"]
    angle: Float[np.ndarray, "k 3"]
    score: float
    expected: Int[np.ndarray, " e"]


def corrected_place(
    sights: Sights, camera: Int[np.ndarray, " n"], error: Float[np.ndarray, "n 8"]
) -> Float[np.ndarray, "n 3 4"]:
    """Maps to the axes of cameras with errors; depth is scaled for their focal lengths."""
    place = sights.place[camera]
    place[..., 3:] -= place[..., :3] @ (sights.unit * error[:, CENTER, None])
    place = Rotation.from_rotvec(error[:, TURN]).as_matrix() @ place
    place[:, 2] *= np.exp(-error[:, ZOOM])
    return place


def match_boxes(
    sights: Sights,
    person: Int[np.ndarray, " m"],
    state: Float[np.ndarray, "m 3"],
    camera: Int[np.ndarray, " n"],
    error: Float[np.ndarray, "n 8"],
) -> list[BoxMatches]:
    """Match people with the boxes of cameras as mutual nearest neighbors.

    Args:
        sights: the recording.
        person: indices of the people to match.
        state: their states.
        camera: (n,) indices of cameras.
        error: (n, 8) assumed error of each camera.

    Returns:
        The matches for each camera and error.
    """
    frame, velocity = sights.people.frame[person], sights.people.velocity[person]
    shift = whole_steps(error)
    moved = np.repeat(state[None], len(camera), 0)
    moved[..., :2] -= (error[:, LAG] - shift)[..., None] * velocity
    shown = frame + shift
    of_all = np.repeat(camera, len(person))
    inside = sights.imaged(of_all, moved.reshape(-1, 3)).reshape(shown.shape)
    of, at = np.nonzero(inside & (shown >= 0) & (shown < sights.steps))
    angle = predicted(moved[of, at], velocity[at], corrected_place(sights, camera, error)[of])
    ends = np.searchsorted(of, np.arange(len(camera) + 1))
    return [
        _nearest(sights.boxes, one, person[at[low:high]], shown[of, at][low:high], angle[low:high])
        for one, (low, high) in zip(camera.tolist(), pairwise(ends.tolist()), strict=True)
    ]


def whole_steps(error: Float[np.ndarray, "n 8"]) -> Int[np.ndarray, "n 1"]:
    """(n, 1) the lags of cameras in whole steps."""
    return np.rint(error[:, LAG]).astype(np.int64)


def _nearest(
    boxes: SightedBoxes,
    camera: int,
    person: Int[np.ndarray, " e"],
    shown: Int[np.ndarray, " e"],
    angle: Float[np.ndarray, "e 3"],
) -> BoxMatches:
    """Match people, expected in some steps at some angles, with a camera's boxes."""
    mine = boxes.of_camera(camera)
    a, b = equal_pairs(shown, boxes.frame[mine])
    b = b + mine.start
    off = (boxes.angle[b] - angle[a]) / (SPREAD * boxes.size[b, None])
    usable = boxes.whole[b, 0] & boxes.whole[b, 1:].any(-1)
    distance = np.where(boxes.whole[b], off**2, 0.0).sum(-1)
    kept = mutually_lowest(np.where(usable & (distance < GATE**2), distance, np.inf), a, b)
    score = float((1 - distance[kept] / GATE**2).sum())
    return BoxMatches(person[a[kept]], b[kept], angle[a[kept]], score, person)


def candidates(
    sights: Sights, camera: int, person: Int[np.ndarray, " m"], shifts: Int[np.ndarray, " s"]
) -> Float[np.ndarray, "k 8"]:
    """Find errors (turns and lags) at which far more boxes match people than by chance.

    Pairs of a person and a box of similar size vote for the angles between them. Boxes at other
    times show how many votes are due to chance.

    Args:
        sights: the recording.
        camera: index of the camera.
        person: indices of people seen by at least two other cameras.
        shifts: lags to try, in steps.
    """
    boxes, people = sights.boxes, sights.people
    mine = boxes.of_camera(camera)
    state, velocity = people.state[person], people.velocity[person]
    place = np.broadcast_to(sights.place[camera], (len(person), 3, 4))
    angle = predicted(state, velocity, place)
    middle = angle[:, 0], angle[:, 1:].mean(-1)
    size = angle[:, 2] - angle[:, 1]
    observed = boxes.angle[mine, 0], boxes.angle[mine, 1:].mean(-1)
    good: np.ndarray = np.asarray(boxes.whole[mine].all(-1))
    # Logarithms of both sizes; NaN never matches.
    tall, high = (
        np.log(x, where=x > 0, out=np.full(len(x), np.nan)) for x in (boxes.size[mine], size)
    )
    side = 2 * REACH + 1
    votes = []
    for shift in shifts:
        a, b = equal_pairs(people.frame[person] + int(shift), boxes.frame[mine])
        alike = good[b] & (np.abs(tall[b] - high[a]) < ALIKE)
        a, b = a[alike], b[alike]
        i, j = (np.rint((observed[k][b] - middle[k][a]) / CELL).astype(int) + REACH for k in (0, 1))
        near = (i >= 0) & (i < side) & (j >= 0) & (j < side)
        votes.append(np.bincount((i * side + j)[near], minlength=side**2))
    stack = correlate(np.array(votes).reshape(-1, side, side), np.ones((1, 3, 3)), mode="constant")
    # Votes of standing people and of chance are the same at most lags.
    excess = stack - np.median(stack, axis=0)[None] * (len(shifts) > 4)
    errors = []
    for _ in range(TRIED):
        peak = int(excess.argmax())
        if excess.ravel()[peak] <= 0:
            break
        top = np.unravel_index(peak, excess.shape)
        azimuth, elevation = ((int(top[i]) - REACH) * CELL for i in (1, 2))
        # A camera turned to the right by an angle sees everybody that much farther left.
        errors.append([-elevation, azimuth, 0.0, float(shifts[top[0]]), 0.0, 0.0, 0.0, 0.0])
        near = tuple(slice(max(0, int(i) - 2), int(i) + 3) for i in top[1:])
        excess[(slice(max(0, int(top[0]) - 1), int(top[0]) + 2), *near)] = 0
    return np.array(errors).reshape(-1, PARAMETERS)


def best(
    sights: Sights,
    camera: int,
    person: Int[np.ndarray, " m"],
    present: Float[np.ndarray, "8"],
    tried: Float[np.ndarray, "k 8"],
) -> Float[np.ndarray, "8"]:
    """The error with the most matches; the present one unless another is clearly better."""
    frame = sights.boxes.frame[sights.boxes.of_camera(camera)]
    errors = np.vstack([present, tried])
    cameras = np.full(len(errors), camera)
    matches = match_boxes(sights, person, sights.people.state[person], cameras, errors)

    def share(one: BoxMatches, shift: Int[np.ndarray, "1"]) -> float:
        """Score per person expected in an image while the camera was recording."""
        shown = sights.people.frame[one.expected] + shift
        return one.score / max(np.count_nonzero((shown >= frame[0]) & (shown <= frame[-1])), 1)

    score = np.array([one.score for one in matches])
    shares = np.array(list(map(share, matches, whole_steps(errors))))
    better = (score >= max(BETTER * score[0], score[0] + FEWEST)) & (shares >= BETTER * shares[0])
    return errors[np.where(better, score, -1.0).argmax()]
