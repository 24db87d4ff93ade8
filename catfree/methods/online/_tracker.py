"""`Tracker`: people on the ground while the video runs."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from catfree.errors import InvalidInputError, quoted
from catfree.geometry._plane import to_plan
from catfree.methods._localize import localize, usable
from catfree.methods.evidence.observe._boxes import float_width_of
from catfree.methods.evidence.report._reported import Reported, no_rows, tracks_of
from catfree.methods.online._advance import advance
from catfree.methods.online._finalize import (
    finalize,
    forget_ended_tracks,
    provisional,
    with_identities,
)
from catfree.methods.online._learn import add_to_sample, is_due, learn_noise_and_unit, learn_step
from catfree.methods.online._tracker_state import (
    TICKS,
    TrackerState,
    fingerprint_of,
    new_state,
    no_boxes,
)
from catfree.methods.online._update import Update
from catfree.settings import Settings
from catfree.types import Clock, Detections, Scene, Tracks
from catfree.types._clock import ABSOLUTE
from catfree.types._detections import concatenate_common
from catfree.types._processes import require_own_process
from catfree.types._scene import require_scene
from catfree.types._validation import (
    as_duration,
    as_integer,
    as_number,
    require_instance,
    require_known_cameras,
)

Cameras = Iterable[int] | Int[np.ndarray, " cam"]


class Tracker:
    """Track people instant by instant: provisional positions now, final ones after `lag`.

    Each call of `update` takes the boxes of one instant. Noise, detection rates and the usual speed
    are learned along the way, from the boxes of a sample of recent instants: after 1, 2, 4, ... 512
    instants and then after every 512. Such a call takes up to a few seconds; all others take
    milliseconds. The tracker has no threads and no clock: time is that of the data.

        tracker = cf.Tracker(scene, lag=2.0)
        for boxes, seconds in instants:
            update = tracker.update(boxes, seconds)
            print(update.provisional.ground_xy, update.final.ground_xy)

    Args:
        scene: cameras and ground, as for `localize`.
        settings: `Settings()` if None; the method must be "evidence".
        lag: seconds after which positions are final: 0 for immediately, `math.inf` for not before
            `finish`, which then returns what `localize` would (all boxes are kept until then).

    Raises:
        InvalidInputError: if the lag is negative, or the method is not "evidence".
        InsufficientDataError: if fewer than two cameras are registered.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings | None = None,
        *,
        lag: float | int = 2.0,
    ) -> None:
        settings = Settings() if settings is None else settings
        require_scene(scene)
        require_instance(settings, Settings, "settings")
        if settings.method != "evidence":
            raise InvalidInputError(
                f"Tracker uses the method 'evidence', not {quoted(settings.method)}. Pass "
                "cf.Settings(), or call cf.localize."
            )
        usable(no_boxes(), scene, settings)  # raises if there are too few cameras
        self.scene, self.settings = scene, settings
        is_endless = isinstance(lag, float) and math.isinf(lag) and lag > 0
        self.lag = math.inf if is_endless else as_duration(lag, "lag")
        self.reset()

    def update(
        self, detections: Detections, time: float | int, cameras: Cameras | None = None
    ) -> Update:
        """Add one instant.

        Args:
            detections: the boxes of all cameras at one instant, in any order; their frame numbers
                and clock are ignored.
            time: seconds; at least a microsecond later than in the previous call.
            cameras: indices of the cameras that delivered a picture, with or without people; None
                for all. The absence of boxes from other cameras is not evidence.

        Returns:
            Positions of this instant, and final positions of all instants at least `lag` old.

        Raises:
            InvalidInputError: if the time is not later, a camera is not in the rig, a camera that
                delivered nothing has a box, a camera has more than 1,000 boxes or all together more
                than 5,000, or the length of embeddings changed.
            ForkedProcessError: in a process forked after JAX was used.
        """
        require_own_process()
        require_instance(detections, Detections, "detections")
        state = self._state
        if state.finished:
            raise InvalidInputError("The tracker has finished; call reset before a new stream.")
        time = as_number(time, "time")
        frame = _frame(time)  # raises if too far from zero
        if state.time > -math.inf and frame <= _frame(float(state.time)):
            raise InvalidInputError(
                f"time is {quoted(time)}, after {state.time:.15g}: it must be a number of seconds "
                "that increases by a microsecond or more. Leave out late instants."
            )
        silent = self._silent(detections, cameras)
        usable_rows = np.flatnonzero(usable(detections, self.scene, self.settings))
        boxes = _copied(detections, usable_rows, 0)
        settings = self.settings.evidence
        with float_width_of(detections.box):
            state = learn_step(state, time)
            state = add_to_sample(state, boxes, silent, settings)
            if is_due(int(state.count) + 1) or np.isnan(state.learned.unit):
                state = learn_noise_and_unit(state, self.scene, settings)
            current = no_rows(self.scene.rig.camera_count)
            if not np.isnan(state.learned.unit):
                state, instant = advance(state, boxes, time, silent, self.scene, settings)
                instant = instant._replace(support=np.append(usable_rows, -1)[instant.support])
                state, current = provisional(state, instant, settings)
                state = replace(state, window=(*state.window, instant))
            state = replace(state, count=np.asarray(state.count + 1), time=np.array(time))
            # Sums of decimal fractions are not exact.
            final_until = time - self.lag + 1e-6
            if self.lag == math.inf:
                state = self._record(state, detections, time, silent)
            ready = sum(float(i.time) <= final_until for i in state.window)
            state, final, events = finalize(state, settings, ready)
            state, current = with_identities(state, current)
            self._state = forget_ended_tracks(state)
        current, final = self._tracks(current, time), self._tracks(final, time)
        return Update(current, final, tuple(events), final_until)

    def finish(self) -> Update:
        """Make all positions final; only `reset` may be called afterwards.

        Returns:
            No provisional positions, and all final ones not yet returned.
        """
        state, time = self._state, float(self._state.time)
        with jax.enable_x64(True):
            state, final, events = finalize(state, self.settings.evidence, len(state.window))
        tracks = self._tracks(final, time)
        if state.recording and not state.finished:
            tracks = self._localized(state)
        self._state = replace(state, finished=np.array(True))
        nobody = self._tracks(no_rows(self.scene.rig.camera_count), time)
        return Update(nobody, tracks, tuple(events), time)

    def reset(self, *, keep_learned: bool = False) -> None:
        """Begin a new stream; its times may start anywhere.

        Args:
            keep_learned: keep what was learned about cameras and people, for instance for the next
                day of the same cameras; identity numbers continue. Otherwise everything is
                forgotten.
        """
        scene = self.scene
        fresh = new_state(scene.rig.camera_count, self.settings.evidence, fingerprint_of(scene))
        if keep_learned:
            kept = ("count", "learned", "sample", "missing", "spacing", "names")
            fresh = replace(fresh, **{name: getattr(self._state, name) for name in kept})
        self._state = fresh

    @property
    def state(self) -> TrackerState:
        """Everything that the tracker remembers, unaffected by later calls; set it to continue.

        Raises:
            InvalidInputError: on setting the state of a tracker with other cameras or another
                ground, or if one lag is infinite and the other is not.
        """
        return self._state

    @state.setter
    def state(self, state: TrackerState) -> None:
        require_instance(state, TrackerState, "state")
        cameras, count = len(state.learned.active), self.scene.rig.camera_count
        if cameras != count:
            raise InvalidInputError(
                f"The state is that of {cameras} cameras, but the scene has {count}. Set the state "
                "of a tracker of the same scene."
            )
        if state.scene != fingerprint_of(self.scene):
            raise InvalidInputError(
                "The state is that of a tracker of another scene: its cameras or its ground "
                "differ. Set the state of a tracker of the same scene, or start a new tracker."
            )
        if state.time > -math.inf and (self.lag == math.inf) != bool(state.recording):
            raise InvalidInputError(
                "The state is that of a tracker "
                f"{'with' if state.recording else 'without'} an infinite lag, which stores other "
                "data. Use it with a tracker of the same kind."
            )
        self._state = state

    def _silent(self, detections: Detections, cameras: Cameras | None) -> Int[np.ndarray, " k"]:
        """(K,) cameras that delivered nothing."""
        count = self.scene.rig.camera_count
        if cameras is None:
            return np.zeros(0, np.int64)
        try:
            listed = list(cameras)
        except TypeError as error:
            raise InvalidInputError(
                f"cameras is {quoted(cameras)}; it must list the indices of the cameras that "
                "delivered a picture."
            ) from error
        delivered = np.unique(as_integer(listed, "cameras"))
        require_known_cameras(delivered, count)
        silent = np.setdiff1d(np.arange(count), delivered)
        contradicting = detections.camera[np.isin(detections.camera, silent)]
        if len(contradicting):
            raise InvalidInputError(
                f"There is a box of camera {contradicting[0]}, which is not among the cameras that "
                "delivered a picture. Name that camera, or leave the box out."
            )
        return silent

    def _record(
        self, state: TrackerState, detections: Detections, time: float, silent: np.ndarray
    ) -> TrackerState:
        """Keep the boxes, the only input of `finish`."""
        frame = _frame(time)
        rows = np.column_stack([np.full(len(silent), frame), silent])
        return replace(
            state,
            window=(),
            recording=(*state.recording, _copied(detections, slice(None), frame)),
            silent=np.concatenate([state.silent, rows]),
        )

    def _localized(self, state: TrackerState) -> Tracks:
        """Return the tracks of `localize` on all boxes."""
        boxes = replace(concatenate_common(state.recording), clock=_clock(float(state.time)))
        tracks = localize(boxes, self.scene, self.settings, silent=state.silent).tracks
        # Rows within the detections of each instant.
        rows = np.concatenate([np.arange(len(part)) for part in state.recording])
        return replace(tracks, support=np.append(rows, -1)[tracks.support])

    def _tracks(self, rows: Reported, time: float) -> Tracks:
        """Convert rows to tracks in the scene's frame and units, sorted by frame and identity."""
        scene, learned = self.scene, self._state.learned
        origin = to_plan(scene, np.asarray(scene.rig.centers)[scene.rig.registered]).mean(0)
        unit = float(np.nan_to_num(learned.unit, nan=1.0))
        pace = unit / float(np.nan_to_num(learned.step, nan=1.0)) / TICKS.frame_rate
        tracks = tracks_of(rows, scene, origin, unit, pace, _clock(time))
        return tracks[np.lexsort((tracks.track_id, tracks.frame))]


def _frame(time: float) -> int:
    return int(TICKS.frame_at(time))


def _clock(time: float) -> Clock:
    return replace(TICKS, utc=abs(time) > ABSOLUTE)


def _copied(detections: Detections, rows: Any, frame: int) -> Detections:
    """Copy some of the boxes into one frame, without a clock."""
    boxes = detections[rows]
    return replace(boxes, frame=np.full(len(boxes), frame), clock=None)
