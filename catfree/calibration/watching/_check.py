"""`check`: has a camera moved, is its clock late, is it dead, and since when?"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri

from catfree.calibration.watching._changes import Course, as_turns, columns_of, lost_since
from catfree.calibration.watching._sights import LAG, PARAMETERS, TURN, Sights, linear
from catfree.calibration.watching._swapped import FEWEST_EXPECTED, swapped_cameras
from catfree.calibration.watching._time_of_change import time_of_change
from catfree.calibration.watching._windows import watch
from catfree.errors import InvalidInputError
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress
from catfree.types._scene import require_scene
from catfree.types._validation import (
    as_count,
    require_boxes_in_images,
    require_different_cameras,
    require_instance,
    require_known_cameras,
    require_names,
    shown_camera,
)

WINDOW = 60.0  # seconds, at most
# Of a person's height on the ground, without a change. Every rig has a small constant error: a
# measured one of a room 0.07, rigs from people and reconstructions about 0.1.
DOUBTFUL, MOVED = 0.12, 0.2
LEAST_MATCHED = 0.25  # share of people; with less, boxes match people only by chance

UNREGISTERED = "The scene has no pose for it. Calibrate again, or leave it out."
TOO_FEW = (
    "Too few people were seen by two other cameras where it looks. Check a longer recording, or "
    "one with more people."
)
SILENT = "It has no boxes of people seen by the others. Check its power, network and video."
ELSEWHERE = (
    "Its boxes match nobody seen by the others: it moved too far to be measured, or shows another "
    "time or place. Look at its picture and calibrate again."
)
UNMATCHED = (
    "Few of its boxes match people seen by the others. Check that its video belongs to this "
    "recording."
)
SWAPPED = (
    "Its boxes fit the place of camera {}: videos or names of cameras were swapped. Give each "
    "camera its own."
)
MOVED_SINCE = "Calibrate again with its boxes since then, or turn it back."
MOVED_ALWAYS = "It does not point where the scene says. Calibrate again."
LATE_SINCE = "Its clock jumped, or frames were lost. Correct its frame numbers since then."
LATE_ALWAYS = "Correct its frame numbers, as cf.estimate_clocks does."
OFF = "It has a small constant error. Refine the rig with cf.refine."


class Verdict(StrEnum):
    """The state of a camera.

    Attributes:
        FITS: it agrees with the others.
        DOUBTFUL: it has a small constant error, or there is too little evidence.
        MOVED: it points elsewhere, or its video was swapped with that of another camera.
        LATE: its frame numbers do not match the time that it shows.
        DEAD: it has no boxes where people are.
    """

    FITS = "fits"
    DOUBTFUL = "doubtful"
    MOVED = "moved"
    LATE = "late"
    DEAD = "dead"


@dataclass(frozen=True, eq=False)
class CameraCheck:
    """The verdict on one camera.

    Attributes:
        camera: index of the camera.
        verdict: the state at the end of the recording.
        since: first frame number of that state, or None if it held from the beginning.
        since_sd: standard deviation of `since` in frame numbers, or None.
        turn: (3,) rotation vector in the camera's axes in radians, relative to the scene or, if it
            moved within the recording, to its pose before it first moved.
        turn_covariance: (3, 3) covariance of `turn`.
        degrees: angle of the turn.
        degrees_sd: its standard deviation.
        pixels: mean distance by which the turn displaces people in the image.
        ground: median distance by which it displaces them on the ground, in scene units.
        lag: frame numbers by which the camera's numbers are ahead of the instant that it shows.
        lag_sd: its standard deviation.
        matched: share of the people seen by other cameras who should be in its image and match one
            of its boxes; NaN if there are none.
        advice: what was found and what to do, in one or two sentences.
        swapped_with: the camera whose place its boxes fit instead of its own, or None.
    """

    camera: int
    verdict: Verdict
    since: int | None
    since_sd: float | None
    turn: Float[np.ndarray, "3"]
    turn_covariance: Float[np.ndarray, "3 3"]
    degrees: float
    degrees_sd: float
    pixels: float
    ground: float
    lag: float
    lag_sd: float
    matched: float
    advice: str
    swapped_with: int | None = None


@dataclass(frozen=True, eq=False)
class Check:
    """The verdicts on a rig from the people that it saw.

    Attributes:
        cameras: one verdict per camera.
        first: first frame number.
        last: last frame number.
        window: length in seconds of the windows of time that were compared.
        metric: whether lengths are meters.
    """

    cameras: tuple[CameraCheck, ...]
    first: int
    last: int
    window: float
    metric: bool

    @property
    def fits(self) -> bool:
        """True if all cameras fit."""
        return all(one.verdict == Verdict.FITS for one in self.cameras)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """(C,) the verdict on each camera."""
        return tuple(one.verdict for one in self.cameras)

    def __str__(self) -> str:
        """One line per camera."""
        return "\n".join(
            f"camera {one.camera}: {one.verdict.value}. {one.advice}" for one in self.cameras
        )


def require_since(since: int | None, detections: Detections) -> int | None:
    """Return the frame number before which the cameras fit, or None if none is given.

    Raises:
        InvalidInputError: if there are no boxes before it, or none from it on.
    """
    if since is None:
        return None
    frame = as_count(since, "since")
    if len(detections):
        first, last = int(detections.frame.min()), int(detections.frame.max())
        if not first < frame <= last:
            raise InvalidInputError(
                f"since is frame {frame}, but the boxes are of frames {first} to {last}: cameras "
                "are compared with the frames before it, and checked from it on. Give a frame "
                "number in between, or leave it out to compare with the scene."
            )
    return frame


def check(
    scene: Scene,
    detections: Detections,
    *,
    since: int | None = None,
    settings: Settings | None = None,
    maximum_offset: int = 20,
    localization: Localization | None = None,
    silent: Any = None,
    camera_names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Check:
    """Check from the people seen whether the cameras still are as in the scene.

    The recording is cut into windows of up to a minute. In each, the people seen by at least two
    cameras show how far every camera is turned and late. A camera moved if these errors change by
    more than chance and the differences between people explain. The thresholds allow one false
    alarm in 200 camera hours; rigs that are off by decimeters have more.

    Args:
        scene: cameras and ground.
        detections: (N,) boxes; without a clock, 25 instants per second are assumed.
        since: frame number before which the cameras are known to fit; turns and lags are relative
            to those before it. None: relative to the scene.
        settings: settings of the localization.
        maximum_offset: largest lag to search for, in frame numbers.
        localization: the result of `localize` for these detections and this scene, if known.
        silent: (K, 2) frame and camera of missing pictures, as for `localize`; if `localization` is
            given, it must have been made with them.
        camera_names: names for error messages and advice about other cameras.
        progress: called as `progress(stage, done, total)`.

    Returns:
        A verdict on each camera, with advice.

    Raises:
        InvalidInputError: if the arguments do not match, there are no boxes before `since` or none
            from it on, two registered cameras have the same boxes, many boxes of one are
            outside its image, the number of names differs from that of cameras, or a picture of
            `silent` has a box.
        InsufficientDataError: if there are no boxes of two registered cameras.
        ForkedProcessError: in a process forked after JAX was used.
    """
    require_scene(scene)
    require_instance(detections, Detections, "detections")
    since = require_since(since, detections)
    require_known_cameras(detections.camera, scene.rig.camera_count)
    require_names(camera_names, scene.rig.camera_count)
    used = detections[scene.rig.registered[detections.camera]]
    require_different_cameras(used.frame, used.camera, used.box, camera_names)
    require_boxes_in_images(used.camera, used.box, scene.rig.image_size, camera_names)
    sights, course, seconds, alpha = watch(
        scene,
        detections,
        settings,
        longest=WINDOW,
        maximum_offset=maximum_offset,
        localization=localization,
        silent=silent,
        since=since,
        progress=progress,
    )
    judge = _Judge(sights, course, as_turns(course), alpha, since is not None)
    cameras = [judge.camera(c) for c in range(scene.rig.camera_count)]
    matched = np.array([one.matched for one in cameras])
    for camera, home in swapped_cameras(sights, matched).items():
        cameras[camera] = replace(
            cameras[camera],
            verdict=Verdict.MOVED,
            since=None,
            since_sd=None,
            advice=SWAPPED.format(shown_camera(home, camera_names)),
            swapped_with=home,
        )
    last = sights.frame(sights.steps - 1)
    return Check(tuple(cameras), sights.first, last, seconds, scene.metric)


class _Found(NamedTuple):
    """A verdict, its advice, and its first frame."""

    verdict: Verdict
    advice: str
    since: int | None = None
    since_sd: float | None = None


@dataclass(frozen=True)
class _Judge:
    """Turn the course of errors into verdicts.

    Attributes:
        sights: the recording.
        course: errors over time.
        turns: the same for cameras that can only turn.
        alpha: probability of a false alarm per window and test.
        fitted_before: whether the cameras are known to fit at the beginning.
    """

    sights: Sights
    course: Course
    turns: Course
    alpha: float
    fitted_before: bool

    def camera(self, camera: int) -> CameraCheck:
        """Judge one camera."""
        sights, last = self.sights, len(self.course.windows) - 1
        of_lag, of_turn = (columns_of(camera, kind) for kind in (LAG, TURN))
        value, covariance = self.course.at(last)
        lag = value[of_lag].item()
        lag_sd = float(np.sqrt(covariance[of_lag, of_lag].item()))
        value, covariance = self.turns.at(last)
        turn, turn_covariance = value[of_turn], covariance[of_turn, of_turn]
        turns, jumps = (self._changes(camera, kind) for kind in (TURN, LAG))
        if turns:
            turn, turn_covariance = self.course.of_changes(turns)
        elif self.fitted_before:
            turn = np.zeros(3)
        if self.fitted_before and not jumps:
            lag = 0.0
        angle, angle_sd = _angle(turn, turn_covariance)
        pixels, ground = self._displacement(camera, turn)
        chance = float(-ndtri(self.alpha / 2))
        off = ground / sights.unit if angle > chance * angle_sd else 0.0
        is_late = abs(lag) > 0.5 + chance * lag_sd
        unmeasured = self._without_people(camera)
        outcome = unmeasured or self._from_errors(turns, jumps, off, is_late=is_late)
        matched, expected, _, _ = self._counts(camera)
        result = CameraCheck(
            camera=camera,
            turn=turn,
            turn_covariance=turn_covariance,
            degrees=angle,
            degrees_sd=angle_sd,
            pixels=pixels,
            ground=ground,
            lag=lag * sights.step,
            lag_sd=lag_sd * sights.step,
            matched=float(matched.sum() / expected.sum()) if expected.any() else float("nan"),
            **outcome._asdict(),
        )
        if unmeasured:
            return result
        unit = "m" if sights.scene.metric else "scene units"
        return replace(result, advice=_measured(result, unit) + result.advice)

    def _counts(self, camera: int) -> Int[np.ndarray, "4 window"]:
        """Count people matched, expected and distinct, and boxes, of a camera in each window."""
        return np.array([window.counts[:, camera] for window in self.course.windows]).T

    def _without_people(self, camera: int) -> _Found | None:
        """Judge a camera that shows nobody, or nobody with certainty; None for others."""
        matched, expected, distinct, boxes = self._counts(camera)
        if not self.sights.scene.rig.registered[camera]:
            return _Found(Verdict.DOUBTFUL, UNREGISTERED)
        if expected.sum() < FEWEST_EXPECTED:
            return _Found(Verdict.DOUBTFUL, TOO_FEW)
        some = (expected > 0) & (boxes > 0)  # a camera that died early was alive before
        share = float(np.median(matched[some] / expected[some])) if some.any() else 0.0
        usual = max(share, LEAST_MATCHED)
        lost = lost_since(matched, expected, distinct, usual, self.alpha)
        if lost is not None:
            since = self.sights.frame(self.course.windows[lost].begin) if lost else None
            dead = not boxes[lost:].any()
            verdict = Verdict.DEAD if dead else Verdict.MOVED
            when = "" if since is None else f"Since about frame {since}. "
            return _Found(verdict, when + (SILENT if dead else ELSEWHERE), since)
        if matched.sum() < LEAST_MATCHED * expected.sum():
            return _Found(Verdict.DOUBTFUL, UNMATCHED if boxes.any() else SILENT)
        return None

    def _from_errors(
        self, turns: list[int], jumps: list[int], off: float, *, is_late: bool
    ) -> _Found:
        """Judge a camera with known errors, as of the end of the recording.

        Args:
            turns: changes of its turn.
            jumps: changes of its lag.
            off: displacement of people on the ground in person heights, 0 if it may be chance.
            is_late: whether its lag is significant and matters.
        """
        for changes, verdict, advice in (
            (turns, Verdict.MOVED, MOVED_SINCE),
            (jumps, Verdict.LATE, LATE_SINCE),
        ):
            if changes:
                since = time_of_change(self.sights, self.course, changes[-1])
                return _Found(verdict, advice, *since)
        if off > MOVED:
            return _Found(Verdict.MOVED, MOVED_ALWAYS)
        if is_late:
            return _Found(Verdict.LATE, LATE_ALWAYS)
        if off > DOUBTFUL:
            return _Found(Verdict.DOUBTFUL, OFF)
        return _Found(Verdict.FITS, "Nothing to do.")

    def _changes(self, camera: int, kind: slice) -> list[int]:
        """Indices of the changes of one camera and kind, in order of time."""
        changes = self.course.changes
        mine = [i for i, one in enumerate(changes) if one.camera == camera and one.kind == kind]
        return sorted(mine, key=lambda i: changes[i].window)

    def _displacement(self, camera: int, turn: Float[np.ndarray, "3"]) -> tuple[float, float]:
        """Mean displacement of people by a turn, in pixels and on the ground."""
        sights = self.sights
        people, boxes = sights.people, sights.boxes
        person = np.flatnonzero(people.seen[:, camera])
        mine = boxes.of_camera(camera)
        if not len(person) or not len(boxes.size[mine]):
            return float("nan"), float("nan")
        person = person[:: max(1, len(person) // 500)]
        place = np.broadcast_to(sights.place[camera], (len(person), 3, 4))
        _, slope = linear(people.state[person], people.velocity[person], place)
        moved = slope[:, :, :3] @ turn
        angle = np.hypot(moved[:, 0], moved[:, 2])
        foot = sights.unit * slope[:, [0, 2]][:, :, PARAMETERS : PARAMETERS + 2]
        usable = np.abs(np.linalg.det(foot)) > 1e-12
        shift = np.linalg.solve(foot[usable], moved[usable][:, [0, 2], None])[..., 0]
        pixels_per_radian = np.median(boxes.height[mine] / boxes.size[mine])
        distance = sights.unit * np.linalg.norm(shift, axis=-1)
        ground = float(np.median(distance)) if len(distance) else float("nan")
        return float(angle.mean() * pixels_per_radian), ground


def _angle(
    turn: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"]
) -> tuple[float, float]:
    """Angle of a rotation vector in degrees, and its standard deviation."""
    angle = float(np.linalg.norm(turn))
    if angle == 0:
        return 0.0, float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(covariance)[-1])))
    axis = turn / angle
    return float(np.rad2deg(angle)), float(np.rad2deg(np.sqrt(axis @ covariance @ axis)))


def _measured(one: CameraCheck, unit: str) -> str:
    """Describe the numbers behind a verdict in a sentence."""
    when = "" if one.since is None else f" since frame {one.since}"
    if one.since_sd is not None:
        when += f" (sd {one.since_sd:.0f})"
    if one.verdict == Verdict.LATE:
        return f"Late by {one.lag:.1f} frames (sd {one.lag_sd:.1f}){when}. "
    if one.verdict == Verdict.FITS:
        return ""
    return (
        f"Turned by {one.degrees:.2f} degrees (sd {one.degrees_sd:.2f}), {one.pixels:.0f} pixels, "
        f"{one.ground:.2f} {unit} on the ground{when}. "
    )
