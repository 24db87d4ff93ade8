"""When exactly errors changed: the frames that divide the boxes best."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.watching._changes import KINDS, Course, fit_course
from catfree.calibration.watching._matching import GATE, SPREAD, Correction, match
from catfree.calibration.watching._sights import Sights
from catfree.calibration.watching._windows import Watched, divided

ELBOW = 4.0  # fall of twice the log likelihood within two standard deviations
NEARBY = 3  # windows before and after, from which the errors there are taken
SHARPER = 0.5  # boxes are more exact than matches demand


def follow_changes(
    watched: Watched,
    alpha: float,
    *,
    kinds: Sequence[slice] = KINDS,
    since: int | None = None,
) -> tuple[Watched, Course]:
    """Fit the errors of all cameras, whose clocks may run at different rates.

    A window in which an error changed fits neither what was before nor what came after: it is
    divided where the boxes say.

    Args:
        watched: the recording.
        alpha: probability at which a change at one given window may be found though there is none.
        kinds: what may change.
        since: frame number before which nothing changes.

    Returns:
        The recording with the divided windows, and its errors.
    """
    course = fit_course(
        watched.windows, alpha, rates=True, kinds=kinds, first=_first(watched, since)
    )
    frames = [time_of_change(watched, course, i)[0] for i in range(len(course.changes))]
    parts = divided(watched, frames)
    if len(parts.windows) == len(watched.windows):
        return watched, course
    first = _first(parts, since)
    return parts, fit_course(parts.windows, alpha, rates=True, kinds=kinds, first=first)


def _first(watched: Watched, since: int | None) -> int:
    """The first window that begins at a frame number or later; at least 1."""
    if since is None:
        return 1
    step = (since - watched.sights.first) // watched.sights.step
    return next((i for i, w in enumerate(watched.windows) if i and w.begin >= step), 1)


def time_of_change(watched: Watched, course: Course, index: int) -> tuple[int, float]:
    """Frame number at which a change began, and its standard deviation.

    The boxes of single frames fit the errors before or those after the change.

    Args:
        watched: the recording.
        course: its errors.
        index: of the change.
    """
    change, sights = course.changes[index], watched.sights
    first = max(change.window - 2, 0)
    last = min(change.window + 1, len(watched.windows) - 1)
    low, high = watched.windows[first].begin, watched.windows[last].stop
    people = sights.people
    person = np.arange(*np.searchsorted(people.frame, [low, high]))
    windows = range(len(watched.windows))
    before, after = (
        _costs(sights, change.camera, person, _usual(watched, change.camera, course.reference, at))
        for at in (
            windows[max(first - NEARBY, 0) : first + 1],
            windows[last : last + NEARBY + 1],
        )
    )
    gain = np.zeros(high - low + 1)
    np.add.at(gain, people.frame[person] - low, before - after)
    total = np.cumsum(gain[::-1])[::-1]
    near = np.flatnonzero(total >= total.max() - ELBOW * course.noise[change.camera].max())
    deviation = max((near[-1] - near[0] + 1) / 4, 0.5)
    step = low + int(total.argmax())
    return sights.first + step * sights.step, float(deviation * sights.step)


def _costs(
    sights: Sights, camera: int, person: Int[np.ndarray, " m"], at: Correction
) -> Float[np.ndarray, " m"]:
    """Squared distance of each person from the nearest box, in deviations."""
    found = match(sights, camera, person, sights.people.state[person], at)
    boxes = sights.boxes
    deviation = SHARPER * SPREAD * boxes.size[found.box, None]
    off = np.where(boxes.whole[found.box], (boxes.angle[found.box] - found.angle) / deviation, 0.0)
    cost = np.full(len(person), GATE**2)
    cost[np.searchsorted(person, found.person)] = np.minimum((off**2).sum(-1), GATE**2)
    return cost


def _usual(watched: Watched, camera: int, reference: int, windows: range) -> Correction:
    """The middle error of a camera in some windows, each found from that window alone."""
    found = [watched.corrections[window] for window in windows]
    turn = np.median([one[camera].turn for one in found], axis=0)
    return Correction(
        turn, float(np.median([one[camera].lag - one[reference].lag for one in found]))
    )
