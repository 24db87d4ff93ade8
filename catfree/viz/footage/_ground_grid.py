"""Draw a grid of the ground on a camera's image, to check a calibration by eye."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from catfree._coverage import visible_area
from catfree.adapters.protocols import Image, as_image
from catfree.errors import InvalidInputError
from catfree.geometry._plane import from_plan
from catfree.geometry.camera import pixels_of_points
from catfree.types import Scene
from catfree.types._scene import require_scene
from catfree.types._validation import as_area, as_count, as_positive, require_known_cameras
from catfree.viz._palette import Color
from catfree.viz.footage._drawing import (
    default_stroke,
    draw_labels,
    draw_polyline,
    round_step,
    visible_runs,
)

LINES_PER_EXTENT = 16  # default spacing: the round number below E / 16, 1 m on a usual square
LABEL_EVERY = 5  # lines
MOST_LINES = 1000  # more would cover the picture
SAMPLES = 8  # points per cell along a line, to follow lens distortion
LINE_COLOR: Color = (235, 235, 235)
X_COLOR: Color = (213, 94, 0)  # the line y = 0
Y_COLOR: Color = (0, 114, 178)  # the line x = 0
SHADOW: Color = (30, 30, 30)


def ground_grid(
    area: tuple[float, float, float, float], spacing: float
) -> list[tuple[str, int, Float[np.ndarray, "n 2"]]]:
    """Sample the lines of constant x and of constant y on the ground.

    Args:
        area: x_min, x_max, y_min, y_max in ground coordinates.
        spacing: distance between the lines in scene units.

    Returns:
        (axis, index, points): the constant axis, "x" or "y", its value divided by the spacing, and
        points (N, 2) along the line in ground coordinates.
    """
    lines = []
    x_min, x_max, y_min, y_max = area
    for axis, low, high, start, end in (
        ("x", x_min, x_max, y_min, y_max),
        ("y", y_min, y_max, x_min, x_max),
    ):
        along = np.linspace(start, end, int(np.ceil((end - start) / spacing * SAMPLES)) + 2)
        for index in range(int(np.ceil(low / spacing)), int(np.floor(high / spacing)) + 1):
            constant = np.full_like(along, index * spacing)
            points = [constant, along] if axis == "x" else [along, constant]
            lines.append((axis, index, np.stack(points, -1)))
    return lines


def draw_ground_grid(
    image: Image,
    scene: Scene,
    camera: int,
    *,
    area: Sequence[float | int] | np.ndarray | None = None,
    spacing: float | int | None = None,
) -> Image:
    """Draw a grid of the ground, with colored axes, on a copy of a camera's image.

    If the lines follow the edges of the floor and stop at walls, rig and ground are correct.

    Args:
        image: (H, W, 3) uint8 RGB of the camera's original size.
        scene: the scene.
        camera: index of a registered camera.
        area: x_min, x_max, y_min, y_max in ground coordinates; None for the area seen by at
            least two cameras.
        spacing: distance between lines in scene units; None for the round number below E / 16.

    Returns:
        (H, W, 3) uint8 RGB. Orange is the line y = 0, blue x = 0; every fifth line is labeled.

    Raises:
        InvalidInputError: if the image is not uint8 RGB or of another size than the camera, the
            camera is not registered, the area or the spacing is not positive, or there are more
            than 1000 lines.
    """
    image, camera = as_image(image), as_count(camera, "camera")
    require_scene(scene)
    require_camera_picture(image, scene, camera)
    if not scene.rig.registered[camera]:
        raise InvalidInputError(
            f"Camera {camera} is not a registered camera of this scene, so the ground cannot be "
            "drawn on its image. Choose a registered camera."
        )
    if spacing is None:
        spacing = round_step(float(scene.extent) / LINES_PER_EXTENT)
    step = as_positive(spacing, "spacing")
    thick = default_stroke(image)
    bounds = visible_area(scene) if area is None else as_area(area)
    count = (bounds[1] - bounds[0] + bounds[3] - bounds[2]) / step
    if not count <= MOST_LINES:
        raise InvalidInputError(
            f"An area of {bounds[1] - bounds[0]:.4g} x {bounds[3] - bounds[2]:.4g} has {count:.3g} "
            f"lines at a spacing of {step:.4g}; draw at most {MOST_LINES}. Pass a larger spacing "
            "or a smaller area."
        )
    canvas, size = image.copy(), (image.shape[1], image.shape[0])
    lines = ground_grid(bounds, step)
    # Axes last, on top of the plain lines.
    for axis, index, points in sorted(lines, key=lambda line: line[1] == 0):
        color = LINE_COLOR if index else (Y_COLOR if axis == "x" else X_COLOR)
        major = index % LABEL_EVERY == 0
        weight = thick * (1.0 if index else 1.5) if major else 1.0
        pixel, in_front = pixels_of_points(scene.rig, camera, from_plan(scene, points))
        for run in visible_runs(pixel, in_front, size):
            if major:
                draw_polyline(canvas, run, SHADOW, weight + 2)
            draw_polyline(canvas, run, color, weight)
    _label_crossings(canvas, scene, camera, lines, step, thick)
    return canvas


def draw_ground_grids(images: Sequence[Image], scene: Scene) -> list[Image]:
    """Draw the same grid on the pictures of all cameras, as `draw_ground_grid` does on one.

    Args:
        images: (H, W, 3) uint8 RGB of each camera; pictures of unregistered cameras stay as they
            are.
        scene: the scene.

    Raises:
        InvalidInputError: as `draw_ground_grid`.
        InsufficientDataError: if fewer than two cameras are registered.
    """
    area = visible_area(scene)
    return [
        draw_ground_grid(image, scene, camera, area=area) if scene.rig.registered[camera] else image
        for camera, image in enumerate(images)
    ]


def require_camera_picture(image: Image, scene: Scene, camera: int) -> None:
    """Raise unless the scene has the camera and the image has its size.

    Raises:
        InvalidInputError: naming the camera and the sizes.
    """
    rig = scene.rig
    require_known_cameras(np.asarray(camera), rig.camera_count)
    width, height = (int(side) for side in rig.image_size[camera])
    if image.shape[:2] != (height, width):
        raise InvalidInputError(
            f"The image of camera {camera} is {image.shape[1]} x {image.shape[0]} px, but the "
            f"scene's camera has {width} x {height} px. Pass the original image."
        )


def _label_crossings(
    canvas: Image,
    scene: Scene,
    camera: int,
    lines: list[tuple[str, int, np.ndarray]],
    step: float,
    stroke: float,
) -> None:
    marked = {axis: [i for a, i, _ in lines if a == axis and i % LABEL_EVERY == 0] for axis in "xy"}
    crossings = np.array([(i, j) for i in marked["x"] for j in marked["y"]], float).reshape(-1, 2)
    pixel, in_front = pixels_of_points(scene.rig, camera, from_plan(scene, crossings * step))
    inside = in_front & (pixel >= 0).all(-1) & (pixel < canvas.shape[1::-1]).all(-1)
    texts = [f"{x * step:g}, {y * step:g}" for x, y in crossings[inside]]
    draw_labels(canvas, texts, pixel[inside], [SHADOW] * len(texts), stroke)
