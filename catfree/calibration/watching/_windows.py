"""A recording in windows: what each says about the cameras' errors."""

from dataclasses import dataclass

import numpy as np

from catfree.calibration.watching._agreement import Window, solve_window
from catfree.calibration.watching._sights import PARAMETERS, Sights, sights
from catfree.methods import localize
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress, no_progress
from catfree.types._processes import require_own_process
from catfree.types._scene import require_scene
from catfree.types._validation import as_count, require_instance

HOURS_PER_ALARM = 200.0  # of one camera to which nothing happened
TESTS = 3  # of a camera in a window: turn, lag, loss
WINDOWS = 12  # that a short recording is cut into
SHORTEST = 2.0  # seconds of a window
UNKNOWN_RATE = 25.0  # steps per second where no clock tells
FEWEST_STEPS = 4  # of a window


@dataclass(frozen=True)
class Watched:
    """What all windows of a recording say.

    Attributes:
        sights: the recording.
        windows: in order.
        seconds: length of a window.
    """

    sights: Sights
    windows: tuple[Window, ...]
    seconds: float

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
    recording = sights(scene, detections, localization, settings)
    rate = (
        UNKNOWN_RATE if detections.clock is None else detections.clock.frame_rate / recording.step
    )
    length = float(np.clip(recording.steps / WINDOWS, SHORTEST * rate, longest * rate))
    steps = max(FEWEST_STEPS, round(length))
    begins = _begins(recording, steps, since)
    reach = min(maximum_offset // recording.step, recording.steps // 3)
    shifts = np.array(sorted(range(-reach, reach + 1), key=abs))
    start = np.zeros((scene.rig.camera_count, PARAMETERS))
    windows: list[Window] = []
    for index, (begin, stop) in enumerate(begins):
        report("windows", index, len(begins))
        windows.append(solve_window(recording, begin, stop, start, shifts))
        start = windows[-1].errors
    report("windows", len(begins), len(begins))
    return Watched(recording, tuple(windows), steps / rate)


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
