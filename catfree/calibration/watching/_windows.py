"""A recording in windows, and the cameras' errors that follow from all of them."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from catfree.calibration.watching._agreement import Window, solve_window
from catfree.calibration.watching._changes import KINDS, Course, fit_course
from catfree.calibration.watching._sights import PARAMETERS, Sights, sights
from catfree.calibration.watching._time_of_change import costs_of_people, time_of_change
from catfree.methods import localize
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress, as_progress
from catfree.types._processes import require_own_process
from catfree.types._scene import require_scene
from catfree.types._validation import as_count, require_instance

HOURS_PER_ALARM = 200.0  # camera hours per false alarm
TESTS = 3  # per camera and window: turn, lag, loss
WINDOWS = 12  # windows of a short recording
SHORTEST = 2.0  # seconds per window
UNKNOWN_RATE = 25.0  # steps per second, assumed without a clock
FEWEST_STEPS = 4  # per window


class Watched(NamedTuple):
    """The errors of a recording's cameras.

    Attributes:
        sights: the recording.
        course: the errors over time.
        seconds: length of a window.
        alpha: probability of a false alarm per window and test.
    """

    sights: Sights
    course: Course
    seconds: float
    alpha: float


def watch(
    scene: Scene,
    detections: Detections,
    settings: Settings | None,
    *,
    longest: float,
    maximum_offset: int,
    kinds: Sequence[slice] = KINDS,
    localization: Localization | None = None,
    silent: Any = None,
    since: int | None = None,
    progress: Progress | None = None,
) -> Watched:
    """Localize the people, and follow how far each camera disagrees with the others.

    Clocks may run at different rates, and with the errors of the whole recording, more boxes match
    people than with those of a single window. A window in which an error changed fits neither the
    errors before nor those after, so it is divided where the boxes indicate. In other windows, a
    few people who walk straight may fit several turns and lags, and the window's own estimate may
    be wrong. Everything is therefore matched and fitted again.

    Args:
        scene: cameras and ground.
        detections: (N,) boxes.
        settings: settings of the localization; None for the default method.
        longest: length in seconds of the windows of a long recording.
        maximum_offset: largest lag to search for, in frame numbers.
        kinds: kinds of errors that may change.
        localization: localization of these detections in this scene, if known.
        silent: frame and camera of missing pictures, as for `localize`.
        since: frame number at which a window begins, and before which nothing changes.
        progress: called as `progress(stage, done, total)`.

    Raises:
        InsufficientDataError: if there are no confident boxes of registered cameras.
        InvalidInputError: as `localize`, or if `maximum_offset` is negative.
        ForkedProcessError: in a process forked after JAX was used.
    """
    require_own_process()
    require_scene(scene)
    require_instance(detections, Detections, "detections")
    settings = Settings() if settings is None else settings
    require_instance(settings, Settings, "settings")
    maximum_offset = as_count(maximum_offset, "maximum_offset", least=0)
    report = as_progress(progress)
    if localization is None:
        localization = localize(detections, scene, settings, progress, silent=silent)
    require_instance(localization, Localization, "localization")
    recording = sights(scene, detections, localization, settings)
    rate = (
        UNKNOWN_RATE if detections.clock is None else detections.clock.frame_rate / recording.step
    )
    length = float(np.clip(recording.steps / WINDOWS, SHORTEST * rate, longest * rate))
    steps = max(FEWEST_STEPS, round(length))
    cut = 0 if since is None else (since - recording.first) // recording.step
    begins = _begins(recording, steps, cut)
    reach = min(maximum_offset // recording.step, recording.steps // 3)
    shifts = np.array(sorted(range(-reach, reach + 1), key=abs))
    start = np.zeros((scene.rig.camera_count, PARAMETERS))
    windows: list[Window] = []
    for index, (begin, stop) in enumerate(begins):
        report("windows", index, len(begins))
        windows.append(solve_window(recording, begin, stop, start, shifts))
        start = windows[-1].errors
    report("windows", len(begins), len(begins))
    seconds = steps / rate
    alpha = seconds / 3600 / HOURS_PER_ALARM / TESTS

    def fitted(windows: Sequence[Window]) -> Course:
        later = (i for i, window in enumerate(windows) if i and window.begin >= cut)
        return fit_course(windows, alpha, kinds=kinds, first=next(later, 1))

    course = fitted(_matched_again(recording, fitted(windows), report))
    return Watched(recording, course, seconds, alpha)


def _matched_again(recording: Sights, course: Course, report: Progress) -> list[Window]:
    """Match everybody with the errors of a course, dividing windows in which an error changed."""
    windows = []
    frames = [time_of_change(recording, course, i)[0] for i in range(len(course.changes))]
    cuts = sorted({-(-(frame - recording.first) // recording.step) for frame in frames})
    for index, window in enumerate(course.windows):
        report("changes", index, len(course.windows))
        inside = [cut for cut in cuts if window.begin < cut < window.stop]
        for begin, stop in pairwise([window.begin, *inside, window.stop]):
            start = _start(recording, course, index, begin, stop)
            windows.append(solve_window(recording, begin, stop, start))
    report("changes", len(course.windows), len(course.windows))
    return windows


def _start(
    recording: Sights, course: Course, index: int, begin: int, stop: int
) -> Float[np.ndarray, "cam 8"]:
    """Errors that a course predicts for a window or a part of it.

    The boxes decide which of a camera's errors over time applies to the window.
    """
    start = course.at(index)[0].reshape(-1, PARAMETERS)
    person = recording.people.between(begin, stop)
    for camera in {change.camera for change in course.changes}:
        others = recording.people.seen_by_others(camera, person)
        changed = [0, *(change.window for change in course.changes if change.camera == camera)]
        tried = [course.at(index, window)[0] for window in changed]
        costs = [costs_of_people(recording, camera, others, errors).sum() for errors in tried]
        start[camera] = tried[int(np.argmin(costs))].reshape(-1, PARAMETERS)[camera]
    return start


def _begins(recording: Sights, steps: int, cut: int) -> list[tuple[int, int]]:
    """First step and step after the last one of each window with boxes; one begins at `cut`."""
    cut = int(np.clip(cut, 0, recording.steps))
    occupied = np.unique(recording.boxes.frame)
    result = []
    for low, high in ((0, cut), (cut, recording.steps)):
        inside = occupied[(occupied >= low) & (occupied < high)]
        length, count = high - low, max(1, (high - low) // steps)
        # Only windows with boxes, in integers, because a recording may have a long gap.
        at = sorted({((frame - low + 1) * count - 1) // length for frame in inside.tolist()})
        result += [(low + k * length // count, low + (k + 1) * length // count) for k in at]
    return result
