"""When exactly errors changed: the frames that divide the boxes best."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.watching._agreement import Window, solve_window
from catfree.calibration.watching._changes import KINDS, Course, fit_course
from catfree.calibration.watching._matching import GATE, SPREAD, best, match_boxes
from catfree.calibration.watching._sights import LAG, PARAMETERS, TURN, Sights
from catfree.calibration.watching._windows import Watched
from catfree.types._annotations import Progress, no_progress

ELBOW = 4.0  # fall of twice the log likelihood within two standard deviations
NEARBY = 3  # windows before and after, from which the errors there are taken
SHARPER = 0.5  # boxes are more exact than matches demand


def follow_changes(
    watched: Watched,
    *,
    kinds: Sequence[slice] = KINDS,
    since: int | None = None,
    progress: Progress | None = None,
) -> tuple[Watched, Course]:
    """Fit the errors of all cameras, whose clocks may run at different rates.

    With the errors of the whole recording, more boxes meet people. A window in which an error
    changed fits neither what was before nor what came after: it is divided where the boxes say. So
    everything is matched and fitted twice.

    Args:
        watched: the recording.
        kinds: what may change.
        since: frame number before which nothing changes.
        progress: called as `progress(stage, done, total)`.

    Returns:
        The recording with the divided windows, and its errors.
    """

    def fitted(watched: Watched) -> Course:
        step = -1 if since is None else (since - watched.sights.first) // watched.sights.step
        later = (i for i, w in enumerate(watched.windows) if i and w.begin >= step)
        return fit_course(watched.windows, watched.alpha, kinds=kinds, first=next(later, 1))

    again = _matched_again(watched, fitted(watched), progress or no_progress)
    return again, fitted(again)


def _matched_again(watched: Watched, course: Course, report: Progress) -> Watched:
    """Match everybody with the errors of a course; divide windows within which one changed."""
    sights, windows = watched.sights, []
    frames = [time_of_change(watched, course, i)[0] for i in range(len(course.changes))]
    cuts = sorted({-(-(frame - sights.first) // sights.step) for frame in frames})
    for index, window in enumerate(watched.windows):
        report("changes", index, len(watched.windows))
        inside = [cut for cut in cuts if window.begin < cut < window.stop]
        for begin, stop in pairwise([window.begin, *inside, window.stop]):
            start = _start(watched, course, index, begin, stop)
            windows.append(solve_window(sights, begin, stop, start, watched.noise))
    report("changes", len(watched.windows), len(watched.windows))
    return replace(watched, windows=tuple(windows))


def _start(
    watched: Watched, course: Course, index: int, begin: int, stop: int
) -> Float[np.ndarray, "cam 8"]:
    """Errors that a course predicts for a window or a part of it.

    A change is believed if far more boxes meet people than without any.
    """
    nearby = [at for at in (index, index - 1, index + 1) if 0 <= at < len(watched.windows)]
    start = course.at(index, changed=False)[0].reshape(-1, PARAMETERS)
    tried = np.array([course.at(window)[0] for window in nearby]).reshape(-1, *start.shape)
    person = watched.sights.people.between(begin, stop)
    for camera in {change.camera for change in course.changes}:
        others = watched.sights.people.seen_by_others(camera, person)
        start[camera] = best(watched.sights, camera, others, start[camera], tried[:, camera])
    return start


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
    people, person = sights.people, sights.people.between(low, high)
    before, after = (
        _costs(sights, change.camera, person, _usual(windows, change.camera, course.reference))
        for windows in (
            watched.windows[max(first - NEARBY, 0) : first + 1],
            watched.windows[last : last + NEARBY + 1],
        )
    )
    gain = np.zeros(high - low + 1)
    np.add.at(gain, people.frame[person] - low, before - after)
    total = np.cumsum(gain[::-1])[::-1]
    near = np.flatnonzero(total >= total.max() - ELBOW * course.noise[change.camera].max())
    deviation = max((near[-1] - near[0] + 1) / 4, 0.5)
    step = low + int(total.argmax())
    return sights.frame(step), float(deviation * sights.step)


def _costs(
    sights: Sights, camera: int, person: Int[np.ndarray, " m"], error: Float[np.ndarray, "8"]
) -> Float[np.ndarray, " m"]:
    """Squared distance of each person from the nearest box, in deviations."""
    state = sights.people.state[person]
    (matches,) = match_boxes(sights, person, state, np.array([camera]), error[None])
    boxes = sights.boxes
    deviation = SHARPER * SPREAD * boxes.size[matches.box, None]
    off = np.where(
        boxes.whole[matches.box], (boxes.angle[matches.box] - matches.angle) / deviation, 0.0
    )
    cost = np.full(len(person), GATE**2)
    cost[np.searchsorted(person, matches.person)] = np.minimum((off**2).sum(-1), GATE**2)
    return cost


def _usual(windows: Sequence[Window], camera: int, reference: int) -> Float[np.ndarray, "8"]:
    """The middle error of a camera in some windows, each found from that window alone."""
    errors = np.array([window.errors for window in windows])
    usual = errors[0, camera].copy()
    usual[TURN] = np.median(errors[:, camera, TURN], axis=0)
    usual[LAG] = np.median(errors[:, camera, LAG] - errors[:, reference, LAG])
    return usual
