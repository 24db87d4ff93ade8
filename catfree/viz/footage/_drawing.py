"""Drawing on images with OpenCV: lines cut outside the view, polygons, labels, grid steps."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.adapters.protocols import Image
from catfree.viz._palette import Color
from catfree.viz._plan_view import place_labels

TEXT_HEIGHT = 11  # pixels of a capital letter per unit of stroke
WHITE: Color = (255, 255, 255)


def in_reach(
    pixel: Float[np.ndarray, "*n 2"], image_size: tuple[int, int] | Int[np.ndarray, "2"]
) -> Bool[np.ndarray, "*n"]:
    """Mark the pixels less than one picture size outside the picture: further out, drawing fails.

    Args:
        pixel: (..., 2).
        image_size: width and height of the picture.
    """
    (u, v), (width, height) = np.moveaxis(pixel, -1, 0), image_size
    return (u > -width) & (u < 2 * width) & (v > -height) & (v < 2 * height)


def visible_runs(
    pixel: Float[np.ndarray, "n 2"],
    in_front: Bool[np.ndarray, " n"],
    image_size: tuple[int, int],
) -> list[Float[np.ndarray, "k 2"]]:
    """Split a polyline into the drawable pieces: two or more points in front and `in_reach`."""
    near = in_reach(pixel, image_size) & in_front
    edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
    return [pixel[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 2]


def default_stroke(image: Image) -> float:
    """Return the default line thickness in pixels for an image: 2 at full HD."""
    return max(1.0, image.shape[0] / 540)


def draw_polyline(
    image: Image,
    points: Float[np.ndarray, "n 2"],
    color: Color,
    stroke: float,
    *,
    closed: bool = False,
) -> None:
    """Draw a line through pixels (N, 2) in place; points must be finite and not far outside."""
    import cv2

    # Sub-pixel positions as fixed-point numbers with four fractional bits.
    fixed = np.round(np.asarray(points) * 16).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(image, [fixed], closed, color, max(1, round(stroke)), cv2.LINE_AA, 4)


def draw_box(image: Image, box: Float[np.ndarray, "4"], color: Color, stroke: float) -> None:
    """Draw the outline of a box x1, y1, x2, y2 in pixels in place."""
    corners = box[[0, 1, 2, 1, 2, 3, 0, 3]].reshape(4, 2)
    draw_polyline(image, corners, color, stroke, closed=True)


def fill_polygon(
    image: Image, points: Float[np.ndarray, "n 2"], color: Color, opacity: float
) -> None:
    """Draw a translucent polygon in place."""
    import cv2

    low = np.maximum(np.floor(points.min(0)).astype(int), 0)
    high = np.minimum(np.ceil(points.max(0)).astype(int) + 1, image.shape[1::-1])
    if (high <= low).any():
        return
    part = image[low[1] : high[1], low[0] : high[0]]
    painted = part.copy()
    fixed = np.round((points - low) * 16).astype(np.int32).reshape(-1, 1, 2)
    cv2.fillPoly(painted, [fixed], color, cv2.LINE_AA, 4)
    part[:] = cv2.addWeighted(painted, opacity, part, 1 - opacity, 0)


def text_size(text: str, stroke: float) -> tuple[int, int]:
    """Compute width and height in pixels of a label, including its background."""
    import cv2

    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, *_font(stroke))
    pad = round(2 * stroke)
    return width + 2 * pad, height + 2 * pad


def draw_label(
    image: Image, text: str, place: tuple[float | int, float | int], color: Color, stroke: float
) -> None:
    """Write text on a background of `color`; `place` is the upper left corner in pixels."""
    import cv2

    width, height = text_size(text, stroke)
    x, y, pad = round(place[0]), round(place[1]), round(2 * stroke)
    cv2.rectangle(image, (x, y), (x + width - 1, y + height - 1), color, cv2.FILLED)
    # Light colors need dark text.
    light = 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2] > 150
    ink = (0, 0, 0) if light else WHITE
    at = (x + pad, y + height - 1 - pad)
    scale, thickness = _font(stroke)
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, thickness, cv2.LINE_AA)


def draw_labels(
    image: Image,
    texts: Sequence[str],
    anchors: Float[np.ndarray, "n 2"],
    colors: Sequence[Color],
    stroke: float,
    *,
    occupied: Float[np.ndarray, "k 4"] | None = None,
    gap: float = 3.0,
) -> Float[np.ndarray, "taken 4"]:
    """Draw labels beside their anchors so that they cover neither each other nor `occupied`.

    `gap` is their distance from the anchors in strokes.

    Returns:
        All occupied rectangles x_min, y_min, x_max, y_max, including the new labels.
    """
    taken = np.zeros((0, 4)) if occupied is None else occupied
    sizes = np.array([text_size(text, stroke) for text in texts], np.float64).reshape(-1, 2)
    bounds = (0.0, float(image.shape[1]), 0.0, float(image.shape[0]))
    places, taken = place_labels(np.asarray(anchors), sizes, bounds, taken, gap=gap * stroke)
    for text, place, color in zip(texts, places, colors, strict=True):
        if place is not None:
            draw_label(image, text, (place[0], place[1]), color, stroke)
    return taken


def round_step(length: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    steps = [step for step in (1.0, 2.0, 5.0) if step * power <= length * (1 + 1e-9)]
    return float(max(steps, default=1.0) * power)


def _font(stroke: float) -> tuple[float, int]:
    # A capital letter of OpenCV's simple Hershey font is 21 pixels high at scale 1.
    return TEXT_HEIGHT * stroke / 2 / 21 + 0.25, max(1, round(0.6 * stroke))
