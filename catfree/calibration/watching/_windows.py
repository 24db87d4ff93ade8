"""A recording in windows: what each says about the cameras' errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from catfree.calibration.watching._agreement import Window, solve_window
from catfree.calibration.watching._matching import CELL, best
from catfree.calibration.watching._sights import LAG, PARAMETERS, TURN, Sights, sights
from catfree.errors import InsufficientDataError
from catfree.methods import localize
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress, no_progress
from catfree.types._detections import is_confident
from catfree.types._processes import require_own_process
from catfree.types._scene import require_scene
from catfree.types._validation import as_count, require_instance

HOURS_PER_ALARM = 200.0  # of one camera to which nothing happened
TESTS = 3  # of a camera in a window: turn, lag, loss
WINDOWS = 12  # that a short recording is cut into
SHORTEST = 2.0  # seconds of a window
UNKNOWN_RATE = 25.0  # steps per second where no clock tells
FEWEST_STEPS = 4  # of a window
FEWEST_TO_COMPARE = 3  # windows, of which one may be wrong
SWEEPS = 3  # in which windows learn from their neighbors


@dataclass(frozen=True)
class Watched:
    """What all windows of a recording say.

    Attributes:
        sights: the recording.
        windows: in order.
        seconds: length of a window.
        noise: of the edges of a box, as a share of its height.
    """

    sights: Sights
    windows: tuple[Window, ...]
    seconds: float
    noise: Float[np.ndarray, "3"]

    @property
    def alpha(self) -> float:
        """Probability of a false alarm per window and test."""
        return self.seconds / 3600 / HOURS_PER_ALARM / TESTS


def watch_windows(
    scene: Scene,
    detections: Detections,
    settings: Settings | None,
    *,
    longest: float,
    maximum_offset: int,
    localization: Localization | None = None,
    since: int | None = None,
    progress: Progress | None = None,
) -> Watched:
    """Localize the people, and see how far each camera disagrees in each window.

    Args:
        scene: cameras and ground.
        detections: (N,) boxes.
        settings: of the localization; the default method if None.
        longest: length of a window in seconds, of a long recording.
        maximum_offset: largest lag to look for, in frame numbers.
        localization: of these detections in this scene, if it is known.
        since: frame number at which a window begins.
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
    report = progress or no_progress
    if localization is None:
        localization = localize(detections, scene, settings, progress)
    require_instance(localization, Localization, "localization")
    localization.require_detections(detections)
    keep = is_confident(detections, settings.confidence)
    confident, tracks = detections[keep], localization.tracks
    if not np.asarray(scene.rig.registered)[confident.camera].any():
        raise InsufficientDataError(
            "Checking a rig needs confident boxes of its registered cameras, but there are none. "
            "Check that the detections belong to the scene, and their scores."
        )
    row = np.append(np.where(keep, np.cumsum(keep) - 1, -1), -1)  # of `confident`
    recording = sights(scene, confident, replace(tracks, support=row[tracks.support]))
    rate = (
        UNKNOWN_RATE if detections.clock is None else detections.clock.frame_rate / recording.step
    )
    length = float(np.clip(recording.steps / WINDOWS, SHORTEST * rate, longest * rate))
    steps = max(FEWEST_STEPS, round(length))
    begins = _begins(recording, steps, since)
    reach = min(maximum_offset // recording.step, recording.steps // 3)
    shifts = np.array(sorted(range(-reach, reach + 1), key=abs))
    start = np.zeros((scene.rig.camera_count, PARAMETERS))
    noise = np.array(settings.evidence.edge_noise)
    windows: list[Window] = []
    for index, (begin, stop) in enumerate(begins):
        report("windows", index, len(begins))
        windows.append(solve_window(recording, begin, stop, start, noise, shifts))
        start = windows[-1].errors
    known = np.flatnonzero(scene.rig.registered).tolist()
    for _ in range(SWEEPS):
        windows = [_with_relative_lags(window, known) for window in windows]
        again = _likelier_starts(recording, windows, known)
        for index, start in again.items():
            begin, stop = begins[index]
            windows[index] = solve_window(recording, begin, stop, start, noise)
        if not again:
            break
    report("windows", len(begins), len(begins))
    return Watched(recording, tuple(windows), steps / rate, noise)


def _with_relative_lags(window: Window, cameras: Sequence[int]) -> Window:
    """Count lags from that of the middle camera."""
    errors = window.errors.copy()
    errors[:, LAG] -= np.median(errors[cameras, LAG])
    return window._replace(errors=errors)


def _likelier_starts(
    recording: Sights, windows: Sequence[Window], cameras: Sequence[int]
) -> dict[int, Float[np.ndarray, "cam 8"]]:
    """The windows that should be solved again, and from which errors of all cameras.

    Few people who walk straight fit several turns and lags. Those of a window are believed if far
    more boxes meet people than with what most windows say, and no fewer than with what the
    neighboring windows say.
    """
    starts = {}
    errors = np.array([window.errors for window in windows])
    for index, usual in enumerate(_usual(windows, errors, cameras)):
        window, start = windows[index], errors[index].copy()
        nearby = [at for at in (index, index - 1, index + 1) if 0 <= at < len(windows)]
        person = recording.people.between(window.begin, window.stop)
        for camera in np.flatnonzero(window.boxes).tolist():
            tried = errors[nearby, camera]
            if all(_is_near(start[camera], one) for one in (usual[camera], *tried)):
                continue
            others = recording.people.seen_by_others(camera, person)
            likely = best(recording, camera, others, usual[camera], tried)
            if not _is_near(start[camera], likely):
                start[camera] = likely
                starts[index] = start
    return starts


def _is_near(one: Float[np.ndarray, "8"], other: Float[np.ndarray, "8"]) -> bool:
    """Return whether a window solved from one error would end up at the other."""
    off = one - other
    return bool(np.abs(off[LAG]) <= 1) and bool(np.linalg.norm(off[TURN]) <= CELL)


def _usual(
    windows: Sequence[Window], errors: Float[np.ndarray, "window cam 8"], cameras: Sequence[int]
) -> Float[np.ndarray, "window cam 8"]:
    """The errors of all cameras in each window that most windows suggest.

    The middle turn of each camera, and the line through the middle of its lags (Theil and Sen).
    """
    time = np.array([(w.begin + w.stop) / 2 for w in windows])
    usual = errors.copy()
    for camera in cameras:
        matched_windows = [i for i, w in enumerate(windows) if w.matched[camera] > 0]
        if len(matched_windows) < FEWEST_TO_COMPARE:
            continue
        mine = errors[matched_windows, camera]
        slope, at_zero = _middle_line(time[matched_windows], mine[:, LAG.start])
        usual[:, camera, TURN] = np.median(mine[:, TURN], axis=0)
        usual[:, camera, LAG.start] = at_zero + slope * time
    return usual


def _middle_line(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Fit a line through points of different x by the middle slope of all pairs (Theil and Sen).

    The same as `scipy.stats.theilslopes`, whose module takes a second to import.

    Returns:
        The slope, and the value at 0 of that line through the middle x and the middle y.
    """
    first, second = np.triu_indices(len(x), 1)
    slope = float(np.median((y[second] - y[first]) / (x[second] - x[first])))
    return slope, float(np.median(y) - slope * np.median(x))


def _begins(recording: Sights, steps: int, since: int | None) -> list[tuple[int, int]]:
    """First step and step after the last one of each window with boxes; one begins at `since`."""
    cut = (
        0
        if since is None
        else int(np.clip((since - recording.first) // recording.step, 0, recording.steps))
    )
    occupied = np.unique(recording.boxes.frame)
    result = []
    for low, high in ((0, cut), (cut, recording.steps)):
        inside = occupied[(occupied >= low) & (occupied < high)]
        count = max(1, (high - low) // steps)
        length = (high - low) / count
        # Of a recording with a long gap, only the windows near boxes.
        near = ((inside - low) / max(length, 1)).astype(int)[:, None] + np.arange(-1, 2)
        at = np.unique(np.clip(near, 0, count - 1))
        begins, stops = (low + length * side for side in (at, at + 1))
        begins, stops = begins.astype(int), np.where(at == count - 1, high, stops).astype(int)
        boxes = np.searchsorted(inside, stops) - np.searchsorted(inside, begins)
        result += zip(begins[boxes > 0].tolist(), stops[boxes > 0].tolist(), strict=True)
    return result
