"""What the cameras recorded, and checks of the input to a run.

Fatal mistakes raise; others become warnings.
"""

import itertools
import math
import os
import re
from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Int

from catfree.adapters import SceneSource, read_scene
from catfree.adapters.datasets._detection_files import CameraBoxes
from catfree.adapters.files._camera_names import (
    distinct_names,
    files_ending,
    is_numbered,
    numbered_names,
    positions_of,
)
from catfree.adapters.files._documents import IMAGE_SUFFIXES, StrPath
from catfree.adapters.files._fingerprint import hash_samples
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.adapters.video._video_sources import ImageFolder
from catfree.calibration import Calibration, remove_offsets
from catfree.calibration.people import place_late_camera
from catfree.calibration.watching import estimate_clocks
from catfree.errors import InsufficientDataError, InvalidInputError, quoted
from catfree.geometry._person import edge_deviation
from catfree.settings import CalibrationSettings, Settings
from catfree.types import Clock, Detections, Localization, Scene
from catfree.types._detections import is_confident
from catfree.types._sampling import frame_step
from catfree.types._scene import require_scene

# What the cameras recorded; code for both kinds uses only camera names and image sizes.
Recording = SynchronizedVideos | CameraBoxes

LONGEST = 60  # instants: largest clock offset to search
WORTH_SAYING = 0.05  # share of the footage lost, as recordings never end on the same frame
# Rose criterion: a signal stands out from noise at five standard deviations.
DEVIATIONS_TO_MEASURE = 5.0


def open_recording(
    paths: Sequence[StrPath],
    frame_rate: float | int | None = None,
    offsets: Sequence[int] | None = None,
) -> SynchronizedVideos:
    """Open the instants of videos that at least two cameras show.

    Raises:
        CatFreeError: as `SynchronizedVideos`.
    """
    fewest = min(len(paths), 2)
    return SynchronizedVideos(paths, offsets=offsets, frame_rate=frame_rate, fewest_cameras=fewest)


def require_distinct_videos(videos: SynchronizedVideos) -> None:
    """Raise if two cameras have the same content under two names.

    Raises:
        InvalidInputError: naming both files.
    """
    paths = [one.path for one in videos.footage]
    files = [[path] if path.is_file() else ImageFolder(path).files for path in paths]
    # Equal recordings have equal sizes and parts, which need little or no reading to compare.
    if _differ([tuple(map(os.path.getsize, camera_files)) for camera_files in files]):
        return
    if _differ([hash_samples(camera_files[len(camera_files) // 2]) for camera_files in files]):
        return
    first: dict[str, int] = {}
    for camera, content in enumerate(videos.content_hashes):
        other = first.setdefault(content, camera)
        if other != camera:
            one, two = videos.footage[other].path, videos.footage[camera].path
            raise InvalidInputError(
                f"Cameras {other} and {camera} are the same recording: {one} and {two} are "
                "equal byte for byte, so the second adds only false confidence. Leave one of "
                "them out."
            )


def _differ(keys: Sequence[Hashable]) -> bool:
    return len(set(keys)) == len(keys)


def scene_of(
    source: Scene | SceneSource | str | os.PathLike[str] | None, names: Sequence[str] | None
) -> tuple[Scene | None, Sequence[str] | None]:
    """Take the scene, and the names of its cameras if known, from any source of a scene.

    Raises:
        InvalidInputError: if the source has no scene.
        FileFormatError: if the source is a file that `read_scene` cannot read.
    """
    if source is None:
        return None, names
    scene: Any
    if isinstance(source, str | os.PathLike):
        scene, stated = read_scene(source)
    else:
        scene = source if isinstance(source, Scene) else getattr(source, "scene", source)
        stated = getattr(source, "camera_names", None)
    require_scene(scene)
    return scene, stated if names is None else names


def order_like(
    scene: Scene, names: Sequence[str] | None, cameras: Sequence[str], kind: str = "videos"
) -> tuple[Scene, tuple[str, ...]]:
    """Put the cameras of a scene in the order of the videos or boxes if names match.

    Args:
        scene: has at least the cameras of the recording.
        names: (C,) names of its cameras, or None if they have none.
        cameras: names of the recording's cameras, to find among `names`.
        kind: kind of recording, "videos" or "boxes".

    Returns:
        The scene, and warnings about cameras that were reordered or left out, or names that do not
        match.

    Raises:
        InvalidInputError: if the scene has more cameras and names do not identify the recording's,
            or a name belongs to a camera in another place.
        InsufficientDataError: if the names match only one of several cameras.
    """
    if names is None:
        return scene, ()
    wanted, given = list(cameras), list(names)
    if wanted == given or len(wanted) > len(given):
        return scene, ()
    order = positions_of(wanted, given)
    if order == list(range(len(given))):
        return scene, ()
    if order is not None:
        warnings = []
        if order != sorted(order):
            warnings.append(
                f"The scene lists its cameras as {', '.join(given)}, the {kind} come as "
                f"{', '.join(wanted)}: they were matched by name."
            )
        if unused := [name for at, name in enumerate(given) if at not in order]:
            warnings.append(
                f"There are no {kind} of these cameras of the scene, so they are not used: "
                f"{', '.join(unused)}."
            )
        if len(order) < 2:
            raise InsufficientDataError(
                " ".join((f"Localization needs {kind} of at least 2 cameras.", *warnings))
            )
        return replace(scene, rig=scene.rig.select(order)), tuple(warnings)
    if kind != "videos" and is_numbered(wanted):  # default names; videos are named by their files
        return scene, ()
    place = [positions_of([name], given) for name in wanted]
    contradicts = any(found not in (None, [at]) for at, found in enumerate(place))
    if len(wanted) < len(given) or contradicts:
        raise InvalidInputError(
            f"The scene has the cameras {', '.join(given)}, but there are {kind} of "
            f"{', '.join(wanted)}, which are not all among them. Give them the same names."
        )
    if is_numbered(given):
        return scene, ()
    return scene, (
        f"The scene names its cameras {', '.join(given)}, the {kind} are {', '.join(wanted)}: "
        "they were matched in the order given. Check that the order is the same.",
    )


def match_cameras(
    scene: Scene, names: Sequence[str] | None, recording: Recording
) -> tuple[Scene, Recording, tuple[str, ...]]:
    """Match the cameras of a scene to those of a recording, and name cameras without boxes.

    Args:
        scene: has at least the cameras of the recording.
        names: (C,) names of its cameras, or None if they have none.
        recording: the footage or boxes.

    Returns:
        The scene in the order of the recording, the recording with a name for each of its cameras,
        and warnings, as `order_like`.

    Raises:
        InvalidInputError: if the recording has other cameras, or images of another size.
        InsufficientDataError: as `order_like`.
    """
    if isinstance(recording, SynchronizedVideos):
        ordered, warnings = order_like(scene, names, recording.camera_names)
        recording.require_cameras(ordered.rig.camera_count)
        _require_same_sizes(ordered, recording)
        return ordered, recording, warnings
    known = recording.camera_names
    ordered, warnings = order_like(scene, names, known, "boxes")
    count = ordered.rig.camera_count
    if count < len(known):
        raise InvalidInputError(
            f"The scene has {count} cameras, but there are boxes of {len(known)}. Leave out the "
            "boxes of the other cameras."
        )
    _require_same_sizes(ordered, recording)
    if ordered is scene and names is not None and is_numbered(known):
        known = tuple(names)
    others = numbered_names(count)[len(known) :]
    known += tuple(distinct_names([*known, *others])[len(known) :])
    return ordered, replace(recording, camera_names=known), warnings


def _require_same_sizes(scene: Scene, recording: Recording) -> None:
    """Raise at the first camera whose image size differs from the scene's."""
    size = recording.image_size
    if size is None:
        return
    known = np.asarray(scene.rig.image_size)[: len(size)]
    differs = (known != size).any(axis=1)
    if differs.any():
        at = int(np.argmax(differs))
        raise InvalidInputError(
            f"Camera {quoted(recording.camera_names[at])} has images of "
            f"{' x '.join(map(str, size[at]))} px, but of {' x '.join(map(str, known[at]))} px in "
            "the scene. Scale one to match the other."
        )


def footage_warnings(videos: SynchronizedVideos) -> tuple[str, ...]:
    """Warn about footage that is missing or unused, and about unknown times.

    Args:
        videos: on their common clock.
    """
    need_all = videos.fewest_cameras == videos.camera_count
    gaps = dropped_instants(videos) if need_all else missing_pictures(videos)
    return lost_footage(videos) + gaps + missing_images(videos) + unknown_times(videos)


def before_damage(videos: SynchronizedVideos) -> tuple[SynchronizedVideos, tuple[str, ...]]:
    """Return the footage before the damage that ended the last iteration, if any, and a warning.

    Args:
        videos: after an iteration over them.
    """
    if videos.interruption is None:
        return videos, ()
    return videos.before_interruption(), (
        f"Used only the footage before the damage, {videos.whole} of {len(videos)} instants: "
        f"{videos.interruption}",
    )


def missing_pictures(videos: SynchronizedVideos) -> tuple[str, ...]:
    """Warn about cameras that lack pictures of instants that the others show.

    Args:
        videos: on their common clock.

    Returns:
        One sentence per camera that dropped frames or lacks many pictures.
    """
    total = len(videos)
    return tuple(
        f"Camera {quoted(one.name)} has no picture of {total - one.pictures} of {total} instants: "
        "it dropped frames, or recorded later or for a shorter time. There the other cameras "
        "locate people alone."
        for one in videos.footage
        if one.dropped or total - one.pictures > WORTH_SAYING * total
    )


def dropped_instants(videos: SynchronizedVideos) -> tuple[str, ...]:
    """Warn about cameras that have no frame near some instants, which are then left out.

    Args:
        videos: on their common clock.

    Returns:
        One sentence per such camera: how many instants are left out because of it.
    """
    return tuple(
        f"Camera {quoted(one.name)} has no frame near {one.dropped} instants, which are not used "
        f"({len(videos)} are): it dropped frames, or its frame rate varies."
        for one in videos.footage
        if one.dropped
    )


def missing_images(videos: SynchronizedVideos) -> tuple[str, ...]:
    """Warn about folders of images numbered with gaps, without a table of times.

    Args:
        videos: on their common clock.

    Returns:
        One sentence per such camera: its first number without an image.
    """
    warnings = []
    for one in videos.footage:
        if not (one.timeless and one.path.is_dir()):
            continue
        files = files_ending(one.path, IMAGE_SUFFIXES)
        digits = [re.findall(r"\d+", file.stem)[-1:] for file in files]
        numbers = [int(last[0]) for last in digits if last]
        steps = [after - before for before, after in itertools.pairwise(numbers)]
        step = math.gcd(*steps)
        # If no two neighbors are one step apart, the numbers do not count images.
        if len(numbers) == len(files) and steps and max(steps) > step == min(steps):
            at = next(n for n, wide in enumerate(steps) if wide > step)
            warnings.append(
                f"Camera {quoted(one.name)} has no image number {numbers[at] + step} in "
                f"{one.path}: after {files[at].name} comes {files[at + 1].name}, which is taken as "
                "the next instant of all cameras. Add the image, or a timestamps.csv."
            )
    return tuple(warnings)


def unknown_times(videos: SynchronizedVideos) -> tuple[str, ...]:
    """Warn about cameras without frame times when others have them.

    Args:
        videos: on their common clock.

    Returns:
        One sentence per such camera: which frame rate is assumed.
    """
    if videos.clock is None:
        return ()
    return tuple(
        f"There are no times for the frames of camera {quoted(one.name)}; they are assumed to be "
        f"even, {videos.clock.frame_rate if one.fps is None else one.fps:g} per second."
        for one in videos.footage
        if one.timeless
    )


def lost_footage(videos: SynchronizedVideos) -> tuple[str, ...]:
    """Warn about cameras that end long before the others, leaving too few to locate people.

    Args:
        videos: on their common clock.

    Returns:
        One sentence per such camera: how much footage of the others is not used.
    """
    footage, rate = videos.footage, videos.fps
    ends = [video.available.stop for video in footage]
    last, longest = sorted(ends)[-videos.fewest_cameras], max(ends)
    warnings = []
    for video, end in zip(footage, ends, strict=True):
        unused = len(range(end, longest, video.available.step))
        if end != last or unused <= WORTH_SAYING * (len(videos) + unused):
            continue
        going_on = sum(other > end for other in ends)
        lasted = f"{unused} instants" + (f" ({unused / rate:.1f} s)" if rate else "")
        others = "1 other camera shows" if going_on == 1 else f"{going_on} other cameras show"
        warnings.append(
            f"Camera {quoted(video.name)} ends early: {lasted} after it, which {others}, are not "
            f"used, and {len(videos)} are."
            + (" Leave the camera out to use them." if going_on > 1 else "")
        )
    return tuple(warnings)


def tiny_boxes(detections: Detections, settings: CalibrationSettings) -> tuple[str, ...]:
    """Warn if most boxes are too small to measure, so not people, or people far away.

    Args:
        detections: boxes of all cameras.
        settings: define the noise of box edges.

    Returns:
        One sentence; none if the boxes are large enough or there are none.
    """
    if not len(detections):
        return ()
    height = np.asarray(detections.height, np.float64)
    # A height has the noise of two edges.
    noise = np.sqrt(2) * edge_deviation(height, settings.relative_sd, settings.pixel_sd)
    if np.mean(height < DEVIATIONS_TO_MEASURE * noise) <= 0.5:
        return ()
    return (
        f"These boxes are not people, or people too far away to measure: the median height of "
        f"{len(detections)} boxes is {np.median(height):.0f} px. Pass a detector of people, or "
        "larger images.",
    )


def clock_warnings(
    localization: Localization,
    detections: Detections,
    scene: Scene,
    videos: Recording,
    settings: Settings,
) -> tuple[str, ...]:
    """Warn about cameras whose clocks do not fit a known scene.

    Args:
        localization: result for the detections in the scene.
        detections: boxes of all cameras.
        scene: known cameras and ground.
        videos: the footage or boxes.
        settings: settings of the run.
    """
    step = frame_step(np.unique(detections.frame))
    try:
        clocks = estimate_clocks(
            scene,
            detections,
            settings=settings,
            maximum_offset=LONGEST * step,
            localization=localization,
        )
    except InsufficientDataError:
        return ()
    offset = clocks.whole_offsets(step)
    return tuple(
        f"Camera {quoted(videos.camera_names[c])} seems to have "
        f"{_started(int(offset[c]), detections.clock)}: with that shift its people match theirs "
        f"best. Nothing was shifted. {_advice(offset, videos)}"
        for c in np.flatnonzero(offset)
    )


def calibrating_score(settings: Settings) -> float:
    """Return the lowest score of boxes used to estimate a rig."""
    return max(settings.confidence, settings.calibration_confidence)


def calibration_warnings(
    calibration: Calibration,
    detections: Detections,
    videos: Recording,
    settings: Settings,
) -> tuple[str, ...]:
    """Warn about clocks that are or seem wrong, and about contradictory anchors.

    Args:
        calibration: the result.
        detections: all boxes, on the clocks as given.
        videos: the footage or boxes, on the clocks as given.
        settings: settings of the run.
    """
    offset = calibration.frame_offset
    warnings = [
        f"Camera {quoted(videos.camera_names[c])} was found to have "
        f"{_started(int(offset[c]), detections.clock)}; its clock was corrected by that."
        for c in np.flatnonzero(offset)
    ]
    warnings += calibration.contradictions
    sure = detections[is_confident(detections, calibrating_score(settings))]
    sure = remove_offsets(sure, offset)
    reach = LONGEST * frame_step(np.unique(sure.frame))
    for camera in np.flatnonzero(~calibration.scene.rig.registered):
        found = place_late_camera(calibration, sure, int(camera), reach, settings.calibration)
        if found is not None:
            started = _started(int(found.frame_offset[camera]), detections.clock)
            warnings.append(
                f"Camera {quoted(videos.camera_names[camera])} could not be placed, but would fit "
                f"if it had {started}. {_advice(found.frame_offset, videos)}"
            )
    return tuple(warnings)


def without_offsets(
    recording: Recording, detections: Detections, frame_offset: Int[np.ndarray, " cam"]
) -> tuple[Recording, Detections]:
    """Put a recording and its boxes on corrected clocks.

    Args:
        recording: the footage or boxes on the clocks as given.
        detections: boxes of all cameras; of footage, those at instants that are left are kept.
        frame_offset: (C,) frames by which each camera's frame numbers are too high.
    """
    moved = remove_offsets(detections, frame_offset)
    if isinstance(recording, SynchronizedVideos):
        corrected = recording.without_offsets(frame_offset.tolist())
        return corrected, moved[np.isin(moved.frame, corrected.frames)]
    silent = recording.silent.copy()
    silent[:, 0] -= frame_offset[silent[:, 1]]
    before = recording.offsets or (0,) * len(frame_offset)
    offsets = tuple(b + by for b, by in zip(before, frame_offset.tolist(), strict=True))
    return replace(recording, silent=silent, offsets=offsets), moved


def _started(offset: int, clock: Clock | None) -> str:
    """Describe when a camera began to record; its frame numbers are too high by `offset`."""
    seconds = "" if clock is None else f" ({abs(offset) / clock.frame_rate:.1f} s)"
    when = "after" if offset < 0 else "before"
    frames = "1 frame" if abs(offset) == 1 else f"{abs(offset)} frames"
    return f"started about {frames}{seconds} {when} the others"


def _advice(offset: Int[np.ndarray, " cam"], videos: Recording) -> str:
    if isinstance(videos, CameraBoxes):
        shifts = ", ".join(
            f"of {quoted(videos.camera_names[c])} by {-offset[c]:+d}"
            for c in np.flatnonzero(offset)
        )
        return f"If so, change the frame numbers {shifts}."
    given = ", ".join(map(str, videos.without_offsets(offset.tolist()).offsets))
    return f"If so, pass offsets=({given})."
