"""The animated bird's-eye view of the overlay video, drawn with OpenCV."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from catfree.adapters.protocols import Image
from catfree.types import Origin, Scene, Tracks
from catfree.viz._palette import CAMERA_COLOR, track_color
from catfree.viz._plan_view import camera_wedges, confidence_ellipse, length_unit
from catfree.viz.footage._drawing import draw_labels, draw_polyline, fill_polygon, round_step

PAPER = (250, 250, 250)
GRID = (222, 222, 222)
GRID_LINES = 6  # approximate number along the longer side
DOT = 3.0  # radius of a position in strokes
CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 49)), np.sin(np.linspace(0, 2 * np.pi, 49))])


class PlanCanvas:
    """A bird's-eye view of the ground on which single frames are drawn."""

    def __init__(
        self,
        scene: Scene,
        view: tuple[float, float, float, float],
        size: tuple[int, int],
        names: Sequence[str],
        stroke: float = 1.0,
    ) -> None:
        """Draw the static parts: grid and cameras.

        Args:
            scene: the scene.
            view: x_min, x_max, y_min, y_max in ground coordinates that must be visible.
            size: width and height of the image in pixels.
            names: (C,) labels of the cameras.
            stroke: line thickness in pixels.
        """
        width, height = size
        self._stroke = stroke
        self._scale = min(width / (view[1] - view[0]), height / (view[3] - view[2]))
        middle = np.array([view[0] + view[1], view[2] + view[3]]) / 2
        self._origin = np.array([width, height]) / 2 - self._scale * np.array([1, -1]) * middle
        self._background = np.full((height, width, 3), PAPER, np.uint8)
        self._draw_grid(length_unit(scene))
        self._draw_cameras(scene, names)

    def to_pixels(self, xy: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Convert ground coordinates (..., 2), with y pointing up, to pixels (..., 2)."""
        return self._origin + self._scale * np.asarray(xy, np.float64) * np.array([1, -1])

    def draw(self, positions: Tracks, trail: Tracks) -> Image:
        """Draw one frame.

        Args:
            positions: positions in the frame.
            trail: positions of the same tracks in recent frames.
        """
        image = self._background.copy()
        for row in range(len(positions)):
            if np.isfinite(positions.covariance[row]).all():
                major, minor, angle = confidence_ellipse(positions.covariance[row])
                turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
                outline = positions.ground_xy[row] + (turn @ (CIRCLE * [[major], [minor]])).T
                # An ellipse far larger than the image carries no information and overflows.
                if major * self._scale < 2 * max(image.shape):
                    color = track_color(positions.track_id[row])
                    fill_polygon(image, self.to_pixels(outline), color, 0.22)
        for identity in np.unique(positions.track_id[positions.track_id >= 0]):
            path = self.to_pixels(trail.ground_xy[trail.track_id == identity])
            if len(path) > 1:
                draw_polyline(image, path, track_color(identity), self._stroke)
        pixel = self.to_pixels(positions.ground_xy)
        for at, identity, origin in zip(pixel, positions.track_id, positions.origin, strict=True):
            draw_dot(image, at, int(identity), bool(origin != Origin.DETECTED), self._stroke)
        tracked, reach = positions.track_id >= 0, DOT * self._stroke
        dots = np.concatenate([pixel - reach, pixel + reach], axis=-1)
        taken = np.concatenate([self._occupied, dots])
        texts = [str(identity) for identity in positions.track_id[tracked]]
        colors = [track_color(identity) for identity in positions.track_id[tracked]]
        anchors, gap = pixel[tracked], DOT + 1.5
        draw_labels(image, texts, anchors, colors, self._stroke, occupied=taken, gap=gap)
        return image

    def _draw_grid(self, unit: str) -> None:
        height, width = self._background.shape[:2]
        low = (np.array([0, height]) - self._origin) / self._scale * np.array([1, -1])
        high = (np.array([width, 0]) - self._origin) / self._scale * np.array([1, -1])
        step = round_step(float((high - low).max()) / GRID_LINES)
        for axis in (0, 1):
            first, last = int(np.ceil(low[axis] / step)), int(np.floor(high[axis] / step))
            for index in range(first, last + 1):
                ends = np.stack([low, high])
                ends[:, axis] = index * step
                draw_polyline(self._background, self.to_pixels(ends), GRID, self._stroke)
        text = f"grid {step:g} {unit}"
        corner = np.array([[0.0, height]])
        self._occupied = draw_labels(
            self._background, [text], corner, [(110, 110, 110)], self._stroke
        )

    def _draw_cameras(self, scene: Scene, names: Sequence[str]) -> None:
        wedges = {camera: self.to_pixels(xy) for camera, xy in camera_wedges(scene).items()}
        for wedge in wedges.values():
            fill_polygon(self._background, wedge, CAMERA_COLOR, 0.2)
            draw_polyline(self._background, wedge, CAMERA_COLOR, self._stroke, closed=True)
        self._occupied = draw_labels(
            self._background,
            [names[camera] for camera in wedges],
            np.array([wedge[0] for wedge in wedges.values()]).reshape(-1, 2),
            [CAMERA_COLOR] * len(wedges),
            self._stroke,
            occupied=self._occupied,
        )


def draw_dot(
    image: Image, at: Float[np.ndarray, "2"], identity: int, hollow: bool, stroke: float
) -> None:
    """Draw a dot in the color of an identity; hollow if no detection supports the position."""
    import cv2

    center, radius = (round(float(at[0])), round(float(at[1]))), max(2, round(DOT * stroke))
    color, line = track_color(identity), max(1, round(stroke))
    cv2.circle(image, center, radius + line, (255, 255, 255), -1, cv2.LINE_AA)
    cv2.circle(image, center, radius, color, line if hollow else -1, cv2.LINE_AA)
