"""Helpers of every plan view: ground coordinates, camera wedges, ellipses, labels."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._camera_names import numbered_names
from catfree.geometry._plane import to_plan
from catfree.geometry.camera import rays_of_pixels
from catfree.types import Rig, Scene
from catfree.types._validation import require_names

MARGIN = 0.05  # empty border of the plan, as a share of its larger side
# Right and up: the places of a label around its anchor, in order of preference.
SIDES = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)])
WEDGE_LENGTH = 0.08  # length of a camera's field of view on the plan, as a share of E


def length_unit(scene: Scene) -> str:
    """Return the unit of lengths: `m`, or `scene units` if the scale is unknown."""
    return "m" if scene.metric else "scene units"


def camera_wedges(scene: Scene) -> dict[int, Float[np.ndarray, "3 2"]]:
    """Find each registered camera's field of view from above: center, left and right end.

    Returns:
        (3, 2) ground coordinates by camera. The ends lie `WEDGE_LENGTH * E` away from the center,
        towards the left and right border of the picture at its middle row.
    """
    rig, wedges = scene.rig, {}
    for camera in np.flatnonzero(rig.registered).tolist():
        width, height = (float(size) for size in rig.image_size[camera])
        middle = (height - 1) / 2
        borders = np.array([[-0.5, middle], [width - 0.5, middle]])
        center = to_plan(scene, np.asarray(rig.centers)[camera])
        direction = to_plan(scene, rays_of_pixels(rig, camera, borders))
        length = np.linalg.norm(direction, axis=-1, keepdims=True)
        # A ray straight down has no direction on the plan.
        direction = direction / np.where(length > 0, length, 1)
        ends = center + WEDGE_LENGTH * float(scene.extent) * direction
        wedges[camera] = np.vstack([center, ends])
    return wedges


def camera_names(rig: Rig, names: Sequence[str] | None = None) -> list[str]:
    """Return one label per camera: the given names, or C1, C2, ...

    Raises:
        InvalidInputError: if there is not one name per camera.
    """
    require_names(names, rig.camera_count)
    return [str(name) for name in (numbered_names(rig.camera_count) if names is None else names)]


def confidence_ellipse(
    covariance: Float[np.ndarray, "2 2"], confidence: float = 0.95
) -> tuple[float, float, float]:
    """Compute the ellipse that holds a Gaussian position with this probability.

    Args:
        covariance: (2, 2) in scene units squared.
        confidence: probability in (0, 1).

    Returns:
        Semi-major and semi-minor axis in scene units, and the angle of the major axis from the
        first ground axis in radians.
    """
    values, vectors = np.linalg.eigh(np.asarray(covariance, np.float64))
    # Two degrees of freedom: the chi-square quantile has a closed form.
    scale = np.sqrt(-2 * np.log1p(-confidence))
    minor, major = scale * np.sqrt(np.maximum(values, 0))
    return float(major), float(minor), float(np.arctan2(vectors[1, 1], vectors[0, 1]))


def view_area(
    scene: Scene,
    xy: Float[np.ndarray, "n 2"],
    area: Sequence[float | int] | np.ndarray | None = None,
) -> tuple[float, float, float, float]:
    """Find the rectangle x_min, x_max, y_min, y_max of all cameras and nearly all positions.

    Args:
        scene: the scene.
        xy: (N, 2) positions in ground coordinates; the outermost 1 % along each axis may be
            outside.
        area: x_min, x_max, y_min, y_max of an area to include, or None.
    """
    parts = list(camera_wedges(scene).values())
    if len(xy):
        parts.append(np.quantile(xy, [0.005, 0.995], axis=0))
    if area is not None:
        parts.append(np.reshape(np.asarray(area, np.float64), (2, 2)).T)
    points = np.concatenate(parts) if parts else np.array([[-1.0, -1.0], [1.0, 1.0]])
    low, high = points.min(0), points.max(0)
    border = MARGIN * max(float((high - low).max()), 1e-3 * float(scene.extent))
    (x_min, y_min), (x_max, y_max) = (low - border).tolist(), (high + border).tolist()
    return x_min, x_max, y_min, y_max


def place_labels(
    anchors: Float[np.ndarray, "n 2"],
    sizes: Float[np.ndarray, "n 2"],
    bounds: tuple[float, float, float, float],
    occupied: Float[np.ndarray, "k 4"],
    gap: float,
) -> tuple[list[Float[np.ndarray, "4"] | None], Float[np.ndarray, "taken 4"]]:
    """Place labels beside their anchors so that none covers another.

    Each label, in order, takes the first free of eight places around its anchor; a label without a
    free place is left out.

    Args:
        anchors: (N, 2) points in display units, in order of importance.
        sizes: (N, 2) width and height of each label.
        bounds: x_min, x_max, y_min, y_max that the labels must stay inside.
        occupied: (K, 4) rectangles x_min, y_min, x_max, y_max that are already taken.
        gap: distance of a label from its anchor.

    Returns:
        Rectangle x_min, y_min, x_max, y_max of each label, or None if there is no room; and all
        occupied rectangles, including the new labels.
    """
    low, high = np.reshape(bounds, (2, 2)).T
    places, taken = [], occupied
    for anchor, size in zip(anchors, sizes, strict=True):
        corner = anchor + SIDES * gap + (SIDES - 1) * size / 2
        inside = (corner >= low) & (corner + size <= high)
        covers = (corner[:, None] < taken[:, 2:]) & ((corner + size)[:, None] > taken[:, :2])
        free = corner[inside.all(-1) & ~covers.all(-1).any(-1)][:1]
        box = np.concatenate([free, free + size], axis=-1)
        places.append(box[0] if len(box) else None)
        taken = np.concatenate([taken, box])
    return places, taken
