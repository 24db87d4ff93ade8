"""Draw tracks on the cameras' images, beside an animated bird's-eye view."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from catfree.adapters import SynchronizedVideos
from catfree.adapters.protocols import Image, as_image
from catfree.errors import InvalidInputError
from catfree.geometry.camera import pixels_of_points
from catfree.types import Detections, Localization, Origin, Scene, Tracks
from catfree.types._annotations import Progress, no_progress
from catfree.types._scene import require_scene
from catfree.types._validation import as_count, as_number, as_path, as_positive, require_instance
from catfree.types._writing import replacement
from catfree.viz._palette import CAMERA_COLOR, track_color
from catfree.viz._person_height import person_height as estimate_person_height
from catfree.viz._plan_view import camera_names as names_of, view_area
from catfree.viz.footage._blur import blur_regions, people_regions, posts
from catfree.viz.footage._contact_sheet import Board
from catfree.viz.footage._drawing import (
    default_stroke,
    draw_box,
    draw_label,
    draw_labels,
    draw_polyline,
    in_reach,
    visible_runs,
)
from catfree.viz.footage._ground_grid import require_camera_picture
from catfree.viz.footage._plan_canvas import CIRCLE, PlanCanvas

STAGE = "overlay"
TRAIL = 20  # past instants shown in the bird's-eye view
PLAN_SHARE = 0.32  # share of the video's width
RING_SHARE = 0.15  # radius of the ring around the feet, in person heights
CODECS = {".webm": "VP80", ".mp4": "mp4v"}
DEFAULT_FPS = 5.0  # for image folders, which have no frame rate


def draw_frame(
    image: Image,
    camera: int,
    frame: int | np.integer,
    detections: Detections,
    localization: Localization,
    scene: Scene,
    *,
    person_height: float | int | None = None,
    stroke: float | int | None = None,
    blur: bool = False,
) -> Image:
    """Draw boxes and tracked people on a copy of one image.

    Every tracked person in view gets a ring on the ground, a post of a person's height and the
    identity. A box has the color of its track, or gray without one. A thin ring marks a position
    without a detection.

    Args:
        image: (H, W, 3) uint8 RGB of the camera's original size.
        camera: index of the camera.
        frame: the frame of `detections` and tracks that the image shows.
        detections: person boxes of the sequence; if empty, no boxes are drawn.
        localization: the result of `cf.localize` for them.
        scene: the scene used for it.
        person_height: height of the posts in scene units; None for the median of the people seen.
        stroke: line thickness in pixels, at most H; None for a default by image size.
        blur: make everybody with a box or a position in the frame unrecognizable. Undetected people
            stay visible.

    Returns:
        (H, W, 3) uint8 RGB. For a camera that is not registered, only boxes are drawn.

    Raises:
        InvalidInputError: if the image is not uint8 RGB or of another size than the camera, there
            is no such camera, the localization was made from other detections, or an argument has
            another type.
    """
    image, camera, frame = as_image(image), as_count(camera, "camera"), as_count(frame, "frame")
    require_instance(detections, Detections, "detections")
    require_instance(localization, Localization, "localization")
    require_scene(scene)
    require_camera_picture(image, scene, camera)
    if len(detections):
        localization.require_detections(detections)
    if person_height is None:
        person_height = estimate_person_height(detections, localization, scene)
    height = as_number(person_height, "person_height")
    thick = default_stroke(image) if stroke is None else as_positive(stroke, "stroke")
    if thick > image.shape[0]:
        raise InvalidInputError(
            f"stroke is {thick:g}; lines can be at most as thick as the image is high, "
            f"{image.shape[0]} pixels."
        )
    canvas = image.copy()
    if blur:
        people = people_regions(camera, frame, detections, localization, scene, height)
        canvas = blur_regions(image, people)
    box_rows = np.flatnonzero((detections.frame == frame) & (detections.camera == camera))
    positions = localization.tracks[localization.tracks.frame == frame]
    identity = localization.identity
    if not scene.rig.registered[camera]:
        positions = positions[:0]
        identity = np.full_like(identity, -1)
    for row in box_rows:
        draw_box(canvas, detections.box[row], track_color(identity[row]), 0.6 * thick)
    _draw_people(canvas, positions, scene, camera, height, thick)
    return canvas


def write_overlay_video(
    path: str | os.PathLike[str],
    videos: SynchronizedVideos | Sequence[str | os.PathLike[str]],
    detections: Detections,
    localization: Localization,
    scene: Scene,
    *,
    width: int = 1920,
    fps: float | int | None = None,
    person_height: float | int | None = None,
    camera_names: Sequence[str] | None = None,
    blur: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a video of all cameras with boxes, identities and posts, beside the bird's-eye view.

    Holds two instants in memory at a time.

    Args:
        path: the file, which appears only once it is complete: `.webm` (VP8, which browsers
            play) or `.mp4` (MPEG-4 Part 2, which is written several times as fast).
        videos: the cameras' videos in the rig's order: one file or image folder each, or
            `SynchronizedVideos` with the frame indices of the detections.
        detections: person boxes of the sequence.
        localization: the result of `cf.localize` for them.
        scene: the scene used for it.
        width: width of the video in pixels; made even.
        fps: frames per second; None for the rate of the videos.
        person_height: height of the posts in scene units; None for the median of the people seen.
        camera_names: (C,) labels; None for C1, C2, ...
        blur: as in `draw_frame`.
        progress: called as progress("overlay", done, total) after each instant.

    Returns:
        The path.

    Raises:
        InvalidInputError: if the number of videos or their sizes do not fit the scene, the
            localization was made from other detections, the path has another suffix, or OpenCV
            cannot write the file.
        FileFormatError: if an image cannot be decoded.
        WriteError: if the folder is not writable.
    """
    import cv2

    target = as_path(path, "path")
    suffix = target.suffix.lower()
    if suffix not in CODECS:
        raise InvalidInputError(
            f"{target} must end in one of {', '.join(CODECS)}, which select the video format."
        )
    source = videos if isinstance(videos, SynchronizedVideos) else SynchronizedVideos(videos)
    source.require_cameras(scene.rig.camera_count)
    if person_height is None:
        person_height = estimate_person_height(detections, localization, scene)
    screen = _Screen(scene, localization.tracks, names_of(scene.rig, camera_names), width)
    rate, report = fps or source.fps or DEFAULT_FPS, progress or no_progress
    codec = CODECS[suffix]
    with replacement(target, suffix=suffix) as partial:
        with _silent_codec():
            fourcc = cv2.VideoWriter.fourcc(*codec)
            writer = cv2.VideoWriter(str(partial), fourcc, rate, screen.size)
        try:
            if not writer.isOpened():
                raise InvalidInputError(
                    f"OpenCV cannot write a {codec} video to {target}. Use another OpenCV build."
                )
            for done, (frame, images) in enumerate(source, start=1):
                pictures = [
                    draw_frame(
                        image,
                        camera,
                        frame,
                        detections,
                        localization,
                        scene,
                        person_height=person_height,
                        stroke=screen.stroke_in(camera),
                        blur=blur,
                    )
                    for camera, image in enumerate(images)
                ]
                writer.write(screen.assemble(frame, pictures)[..., ::-1].copy())
                report(STAGE, done, source.frame_count)
        finally:
            writer.release()
    return target


@contextlib.contextmanager
def _silent_codec() -> Iterator[None]:
    """Discard OpenCV's message on standard error that WebM has no codec tags."""
    with contextlib.ExitStack() as stack, open(os.devnull, "wb") as nothing:
        with contextlib.suppress(OSError):  # there may be no standard error
            kept = os.dup(2)
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, 2)
            os.dup2(nothing.fileno(), 2)
        yield


class _Screen:
    """Layout of the camera images and the bird's-eye view in the video's frames."""

    def __init__(self, scene: Scene, tracks: Tracks, names: Sequence[str], width: int) -> None:
        sizes = np.asarray(scene.rig.image_size, np.float64)
        count = len(sizes)
        tallest = float((sizes[:, 1] / sizes[:, 0]).max())
        columns = _tile_columns(count, tallest)
        tile = int(width * (1 - PLAN_SHARE)) // columns // 2 * 2
        if tile < 16:
            raise InvalidInputError(
                f"width is {width} pixels, too small for {count} cameras. Pass a larger one."
            )
        tile_height = max(round(tile * tallest / 2) * 2, 2)
        self._board = Board.of(scene.rig.image_size, columns, (tile, tile_height))
        self.size = (int(width) // 2 * 2, self._board.size[1])
        self._stroke = max(1.0, tile / 480)
        self._names, self._tracks = names, tracks
        view = view_area(scene, tracks.ground_xy)
        plan = (self.size[0] - self._board.size[0], self.size[1])
        self._plan = PlanCanvas(scene, view, plan, names, self._stroke)
        self._frames = np.unique(tracks.frame)

    def stroke_in(self, camera: int) -> float:
        """Return the thickness in the original image that becomes the board's stroke."""
        return float(self._stroke / self._board.scale[camera])

    def assemble(self, frame: int, pictures: Sequence[Image]) -> Image:
        board = self._board.assemble(pictures)
        width = self._board.tile[0]
        for name, (x, y) in zip(self._names, self._board.tiles[:, :2], strict=True):
            draw_label(board[y:, x : x + width], name, (0, 0), CAMERA_COLOR, self._stroke)
        first = max(int(np.searchsorted(self._frames, frame, side="right")) - TRAIL, 0)
        since = self._frames[first] if first < len(self._frames) else frame
        rows = slice(*np.searchsorted(self._tracks.frame, [since, frame + 1]))
        recent = self._tracks[rows]
        plan = self._plan.draw(recent[recent.frame == frame], recent)
        draw_label(plan, f"frame {frame}", (0, 0), CAMERA_COLOR, self._stroke)
        return np.hstack([board, plan])


def _tile_columns(count: int, ratio: float) -> int:
    """Choose the columns for a video near 16:9; `ratio` is a tile's height over its width."""
    columns = np.arange(1, count + 1)
    height = (1 - PLAN_SHARE) * np.ceil(count / columns) / columns * ratio
    return int(columns[np.argmin(np.abs(np.log(height * 16 / 9)))])


def _draw_people(
    canvas: Image, tracks: Tracks, scene: Scene, camera: int, height: float, stroke: float
) -> None:
    basis = np.asarray(scene.ground.basis, np.float64)
    ring = RING_SHARE * height * CIRCLE.T @ basis.T
    size = (canvas.shape[1], canvas.shape[0])
    texts, anchors, colors = [], [], []
    people = zip(*posts(tracks.position, height, scene, camera), strict=True)
    for position, identity, origin, (head, foot, imaged) in zip(
        tracks.position, tracks.track_id, tracks.origin, people, strict=True
    ):
        color = track_color(identity)
        post = np.stack([foot, head])
        in_picture = ((post >= 0) & (post < size)).all(-1).any()
        if not (imaged and in_picture and in_reach(post, size).all()):
            continue
        pixel, in_front = pixels_of_points(scene.rig, camera, position + ring)
        for run in visible_runs(pixel, in_front, size):
            draw_polyline(canvas, run, color, (1 if origin != Origin.DETECTED else 2) * stroke)
        if height > 0:
            draw_polyline(canvas, post, color, 1.5 * stroke)
        if identity >= 0:
            texts.append(str(identity))
            anchors.append(head)
            colors.append(color)
    draw_labels(canvas, texts, np.array(anchors).reshape(-1, 2), colors, stroke)
