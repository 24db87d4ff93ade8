"""`estimate_clocks`: offset, rate and jumps of every camera's clock, from walking people."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration.watching._sights import LAG, LAGS
from catfree.calibration.watching._time_of_change import time_of_change
from catfree.calibration.watching._windows import watch
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress
from catfree.types._sampling import frame_step

WINDOW = 10.0  # seconds, at most, because clocks drift within a window
SURE = 4.0  # standard deviations from half a step for a lag to count as more than that


class ClockJump(NamedTuple):
    """A step of one clock, as after dropped frames.

    Attributes:
        camera: index of the camera.
        frame: first frame number after the jump.
        frame_sd: its standard deviation.
        frames: number of frame numbers by which the clock fell behind.
        frames_sd: its standard deviation.
    """

    camera: int
    frame: int
    frame_sd: float
    frames: float
    frames_sd: float


@dataclass(frozen=True, eq=False)
class Clocks:
    """The clocks of all cameras, relative to one of them.

    At frame number f, camera c shows the instant `f - lag(f)[c]` of the reference.

    Attributes:
        offset: (C,) frame numbers by which each camera's numbers are too high at `frame`, before
            any jump; NaN for cameras that are not registered, as in the following.
        offset_sd: (C,) standard deviations.
        rate: (C,) growth of `offset` per frame number.
        rate_sd: (C,) standard deviations.
        jumps: steps of single clocks.
        frame: middle of the recording.
        reference: the camera that is correct by definition, before any jump of its own: the one
            whose lags are nearest to those of all others over the recording.
    """

    offset: Float[np.ndarray, " cam"]
    offset_sd: Float[np.ndarray, " cam"]
    rate: Float[np.ndarray, " cam"]
    rate_sd: Float[np.ndarray, " cam"]
    jumps: tuple[ClockJump, ...]
    frame: float
    reference: int

    def lag(self, frame: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n cam"]:
        """(n, C) frame numbers by which each camera's numbers are too high, at given ones."""
        at = np.asarray(frame, np.float64)[:, None]
        lag = self.offset + self.rate * (at - self.frame)
        for jump in self.jumps:
            lag[:, jump.camera] += jump.frames * (at[:, 0] >= jump.frame)
        return lag

    def whole_offsets(self, step: int) -> Int[np.ndarray, " cam"]:
        """Round the lags in the middle of the recording that certainly exceed half a step.

        Args:
            step: frame numbers from one frame to the next.

        Returns:
            (C,) frame numbers to subtract, as `remove_offsets` does; 0 where a lag is smaller or
            uncertain.
        """
        middle = round(self.frame)
        lag = np.nan_to_num(self.lag(np.array([middle]))[0])
        variance = np.nan_to_num(self.offset_sd) ** 2
        for jump in self.jumps:
            variance[jump.camera] += jump.frames_sd**2 * (jump.frame <= middle)
        sure = np.abs(lag) > step / 2 + SURE * np.sqrt(variance)
        return step * np.rint(np.where(sure, lag, 0.0) / step).astype(np.int64)

    def correct(self, detections: Detections) -> Detections:
        """Renumber the frames of all cameras to match the reference, to the nearest frame.

        Frame numbers move by whole steps between neighboring frames. Where a clock runs slow, two
        instants may get the same number; the boxes of the later one are then left out.

        Args:
            detections: (N,) boxes on the clocks that were estimated.

        Returns:
            (n,) boxes in the same order.
        """
        frames = np.unique(detections.frame)
        step = frame_step(frames)
        lag = self.lag(detections.frame)[np.arange(len(detections)), detections.camera]
        lag = np.where(np.isfinite(lag), lag, 0.0)
        moved = detections.frame - step * np.rint(lag / step).astype(np.int64)
        keep = np.ones(len(detections), bool)
        for camera in np.unique(detections.camera):
            mine = np.flatnonzero(detections.camera == camera)
            order = mine[np.argsort(detections.frame[mine], kind="stable")]
            number, first = np.unique(moved[order], return_index=True)
            source = detections.frame[order][first]
            keep[mine] = detections.frame[mine] == source[np.searchsorted(number, moved[mine])]
        return replace(detections, frame=moved)[keep]


def estimate_clocks(
    scene: Scene,
    detections: Detections,
    *,
    settings: Settings | None = None,
    maximum_offset: int = 20,
    localization: Localization | None = None,
    silent: Any = None,
    progress: Progress | None = None,
) -> Clocks:
    """Estimate each camera's lag, clock rate error, and jumps after lost frames.

    A late camera shows people where they were: their boxes lag behind them, in proportion to their
    speed. Small turns of all cameras are estimated at the same time, so that errors of the scene do
    not count as lags.

    Args:
        scene: cameras and ground.
        detections: (N,) boxes of walking people.
        settings: settings of the localization.
        maximum_offset: largest lag to search for, in frame numbers.
        localization: the result of `localize` for these detections and this scene, if known.
        silent: as for `check`.
        progress: called as `progress(stage, done, total)`.

    Returns:
        Offsets, rates and jumps with standard deviations.

    Raises:
        InvalidInputError: if the arguments do not match.
        InsufficientDataError: if there are no boxes of two registered cameras.
        ForkedProcessError: in a process forked after JAX was used.
    """
    sights, course, _, _ = watch(
        scene,
        detections,
        settings,
        longest=WINDOW,
        maximum_offset=maximum_offset,
        kinds=[LAG],
        localization=localization,
        silent=silent,
        progress=progress,
    )
    step, registered = sights.step, scene.rig.registered
    constant, covariance = course.constant()
    rate, rate_covariance = course.rates()

    def known(values: Float[np.ndarray, " cam"]) -> Float[np.ndarray, " cam"]:
        return np.where(registered, values, np.nan)

    jumps = []
    for index, change in enumerate(course.changes):
        frame, frame_sd = time_of_change(sights, course, index)
        by, by_covariance = course.of_changes([index])
        size = float(np.sqrt(by_covariance[0, 0]))
        jumps.append(ClockJump(change.camera, frame, frame_sd, float(by[0]) * step, size * step))
    middle = np.mean([(w.begin + w.stop) / 2 for w in course.windows])
    return Clocks(
        offset=known(constant[LAGS] * step),
        offset_sd=known(np.sqrt(covariance.diagonal()[LAGS]) * step),
        rate=known(rate),
        rate_sd=known(np.sqrt(rate_covariance.diagonal())),
        jumps=tuple(sorted(jumps, key=lambda jump: jump.frame)),
        frame=float(sights.first + middle * step),
        reference=course.reference,
    )
