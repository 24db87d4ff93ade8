"""The exact time of a change of errors: the frame that divides the boxes best."""

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.watching._changes import Course
from catfree.calibration.watching._matching import GATE, match_boxes
from catfree.calibration.watching._sights import PARAMETERS, Sights

ELBOW = 4.0  # drop of twice the log likelihood within two standard deviations


def time_of_change(sights: Sights, course: Course, index: int) -> tuple[int, float]:
    """Find the frame number at which a change began, and its standard deviation.

    The boxes of each frame fit either the errors before or those after the change.

    Args:
        sights: the recording.
        course: errors over time.
        index: index of the change.
    """
    change, windows = course.changes[index], course.windows
    first = max(change.window - 2, 0)
    last = min(change.window + 1, len(windows) - 1)
    low, high = windows[first].begin, windows[last].stop
    people, person = sights.people, sights.people.between(low, high)
    before, after = (
        costs_of_people(sights, change.camera, person, course.at(window)[0])
        for window in (first, last)
    )
    gain = np.zeros(high - low + 1)
    np.add.at(gain, people.frame[person] - low, before - after)
    total = np.cumsum(gain[::-1])[::-1]
    near = np.flatnonzero(total >= total.max() - ELBOW * course.noise[change.camera].max())
    deviation = max((near[-1] - near[0] + 1) / 4, 0.5)
    step = low + int(total.argmax())
    return sights.frame(step), float(deviation * sights.step)


def costs_of_people(
    sights: Sights, camera: int, person: Int[np.ndarray, " m"], errors: Float[np.ndarray, " p"]
) -> Float[np.ndarray, " m"]:
    """Squared distance of each person from the nearest box, in standard deviations."""
    boxes = sights.boxes
    error = errors.reshape(-1, PARAMETERS)[[camera]]
    (matches,) = match_boxes(sights, person, sights.people.state[person], np.array([camera]), error)
    off = (boxes.angle[matches.box] - matches.angle) / boxes.deviation[matches.box]
    cost = np.full(len(person), GATE**2)
    squared = np.where(boxes.whole[matches.box], off**2, 0.0).sum(-1)
    cost[np.searchsorted(person, matches.person)] = np.minimum(squared, GATE**2)
    return cost
