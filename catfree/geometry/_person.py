"""A standing person, a vertical segment (x, y, height) on the ground z = 0, and its box.

Everything that predicts a box, or measures a person from one, uses these functions. The pinhole
functions are unbatched JAX functions for `vmap` and `jacfwd`; they also broadcast over leading
axes, and take NumPy arrays where few boxes are needed at a time.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Num

from catfree.geometry._arrays import float_arrays, require_vectors
from catfree.geometry._buckets import in_blocks
from catfree.geometry._canonical_frame import CanonicalFrame
from catfree.geometry.camera import pixels_of_points, rays_of_pixels
from catfree.types import Detections, Localization, Rig, Scene
from catfree.types._annotations import HostOrDevice

NEAREST_DEPTH = 0.1  # of the third homogeneous coordinate: nearer points are projected from there
ASPECT = 0.4  # width of the box of a standing person, in box heights
BLOCK = 1024  # people measured together

Lens = Callable[[Float[Array, "*n 2"]], Float[Array, "*n 2"]]


def visible_foot(
    position: Float[HostOrDevice, "*#n 2"],
    station: Float[HostOrDevice, "*#n 2"],
    foot_offset: Any,
) -> tuple[Any, Any]:
    """Find the ground point (x, y) of a person's visible foot; see `box_edges`.

    With a negative offset, this is the position of the person whose visible foot is at a point.
    """
    xp = position.__array_namespace__()
    x, y = position[..., 0], position[..., 1]
    dx, dy = x - station[..., 0], y - station[..., 1]
    nearer = foot_offset / xp.sqrt(xp.maximum(dx**2 + dy**2, 1e-12))
    return x - nearer * dx, y - nearer * dy


def box_ends(
    matrix: Float[HostOrDevice, "*#n 3 4"],
    person: Float[HostOrDevice, "*#n 3"],
    station: Float[HostOrDevice, "*#n 2"],
    foot_offset: Float[HostOrDevice, ""] | float,
    lens: Lens | None = None,
) -> tuple[Any, Any, Any]:
    """Project the head and the visible foot of a standing person; see `box_edges`.

    Returns:
        (2,) head and (2,) foot in pixels, and () the depth of the nearer one.
    """
    xp = person.__array_namespace__()
    x, y, height = (person[..., i] for i in range(3))
    rows = [[matrix[..., i, j] for j in range(4)] for i in range(3)]
    pixels, depths = [], []
    for end in ((x, y, height), (*visible_foot(person[..., :2], station, foot_offset), 0.0)):
        column, row, depth = (m[0] * end[0] + m[1] * end[1] + m[2] * end[2] + m[3] for m in rows)
        near = xp.maximum(depth, NEAREST_DEPTH)
        pixel = xp.stack([column / near, row / near], -1)
        pixels.append(pixel if lens is None else lens(pixel))
        depths.append(depth)
    return *pixels, xp.minimum(*depths)


def box_edges(
    matrix: Float[HostOrDevice, "*#n 3 4"],
    person: Float[HostOrDevice, "*#n 3"],
    station: Float[HostOrDevice, "*#n 2"],
    foot_offset: Float[HostOrDevice, ""] | float,
    lens: Lens | None = None,
) -> Any:
    """Predict the edges of the box of a standing person.

    The visible foot is nearer to the camera than the axis of the body, whose top is the head.

    Args:
        matrix: (3, 4) projection of homogeneous points over the ground; the third coordinate of the
            result is the depth, in units of the ground.
        person: (3,) position on the ground and height.
        station: (2,) the camera's center, projected onto the ground.
        foot_offset: distance by which the foot is nearer.
        lens: map (2,) of the projected points to pixels; they are pixels if None.

    Returns:
        (3,) center column, head row and foot row in pixels.
    """
    return edges_of(*box_ends(matrix, person, station, foot_offset, lens)[:2])


def edges_of(head: Float[HostOrDevice, "*n 2"], foot: Float[HostOrDevice, "*n 2"]) -> Any:
    """Return center column, head row and foot row (3,) of a box, from head (2,) and foot (2,)."""
    xp = head.__array_namespace__()
    return xp.stack([(head[..., 0] + foot[..., 0]) / 2, head[..., 1], foot[..., 1]], -1)


def edges_and_slopes(
    matrix: Float[Array, "3 4"],
    person: Float[Array, "3"],
    station: Float[Array, "2"],
    foot_offset: float,
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Compute `box_edges` and its Jacobian (3, 3) with respect to the person."""

    def edges(person: Float[Array, "3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        shown = box_edges(matrix, person, station, foot_offset)
        return shown, shown

    slopes, shown = jax.jacfwd(edges, has_aux=True)(person)
    return shown, slopes


def people_in_rig(
    rig: Rig,
    camera: int | np.integer | Int[np.ndarray, " n"],
    person: Float[np.ndarray, "n 3"],
    foot_offset: Float[np.ndarray, " n"] | float = 0.0,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Project heads and visible feet of people into cameras with any lenses.

    Args:
        rig: the cameras, in a world whose ground is z = 0, with z up.
        camera: (n,) the camera of each person, or one for all.
        person: (n, 3) positions on the ground and heights.
        foot_offset: distance by which the foot is nearer to the camera, per person or for all.

    Returns:
        head: (n, 2) in original image pixels, possibly outside the image.
        foot: (n, 2) likewise.
        imaged: (n,) whether both pixels are images of the person.
    """
    cameras = np.broadcast_to(camera, len(person))
    station = np.asarray(rig.centers, np.float64)[cameras, :2]
    foot = np.stack([*visible_foot(person[:, :2], station, foot_offset), np.zeros(len(person))], -1)
    pixel, imaged = pixels_of_points(rig, np.tile(cameras, 2), np.concatenate([person, foot]))
    (high, low), (high_imaged, low_imaged) = np.split(pixel, 2), np.split(imaged, 2)
    return high, low, high_imaged & low_imaged


def edge_deviation(
    size: Float[HostOrDevice, "*#n"], share: Float[HostOrDevice, "*#n"] | float, floor: Any
) -> Any:
    """Compute the standard deviation in pixels of an edge of a box.

    Args:
        size: () height of the box in pixels.
        share: () part of the deviation that grows with the box, in box heights.
        floor: () constant part, in pixels.
    """
    return ((share * size) ** 2 + floor**2) ** 0.5


def cut_by_border(
    box: Float[np.ndarray, "n 4"], image_size: Num[np.ndarray, "*n 2"], margin: float
) -> Bool[np.ndarray, "n 3"]:
    """Mark the boxes that the image border cuts at a side, at the top and at the bottom, (n, 3).

    Args:
        box: (n, 4) x1, y1, x2, y2 in pixels.
        image_size: (n, 2) or (2,) width and height in pixels.
        margin: share of the width within which an edge counts as cut.
    """
    width, height = image_size[..., 0], image_size[..., 1]
    near = margin * width
    side = (box[:, 0] <= near) | (box[:, 2] >= width - 1 - near)
    return np.stack([side, box[:, 1] <= near, box[:, 3] >= height - 1 - near], -1)


def drop_to_height(
    inverse: Float[HostOrDevice, "*#n 3 3"], pixel: Float[HostOrDevice, "*#n 2"]
) -> Any:
    """Find the position of a person whose foot, or point at another height, is at a pixel.

    Args:
        inverse: (3, 3) map from pixels to homogeneous positions on the plane of that height.
        pixel: (2,).

    Returns:
        (2,) position; arbitrary where the ray does not reach the plane.
    """
    xp = pixel.__array_namespace__()
    column, row = pixel[..., 0, None], pixel[..., 1, None]
    point = inverse[..., 0] * column + inverse[..., 1] * row + inverse[..., 2]
    denominator = point[..., 2:]
    return point[..., :2] / xp.where(xp.abs(denominator) < 1e-12, 1e-12, denominator)


def height_at(
    matrix: Float[HostOrDevice, "*#n 3 4"],
    position: Float[HostOrDevice, "*#n 2"],
    row: Float[HostOrDevice, "*#n"],
) -> Any:
    """Find the height at which a person at a position reaches an image row.

    Args:
        matrix: (3, 4) projection, as in `box_edges`.
        position: (2,) on the ground.
        row: () in pixels.

    Returns:
        () finite; arbitrary if the vertical does not cross the row.
    """
    xp = position.__array_namespace__()
    x, y = position[..., 0], position[..., 1]
    base = [matrix[..., i, 0] * x + matrix[..., i, 1] * y + matrix[..., i, 3] for i in (1, 2)]
    gain = matrix[..., 1, 2] - row * matrix[..., 2, 2]
    return (row * base[1] - base[0]) / xp.where(xp.abs(gain) < 1e-12, 1e-12, gain)


def implied_height(
    center: Num[HostOrDevice, "3"],
    ray: Num[HostOrDevice, "3"],
    position: Num[HostOrDevice, "3"],
    normal: Num[HostOrDevice, "3"],
    offset: Num[HostOrDevice, ""],
) -> Float[Array, ""]:
    """Find the height of a person at a position, taking the box's top as the top of the head.

    This is the height above the ground at which the vertical through the position and the ray
    through the middle of the upper box edge come closest.

    Args:
        center: (3,) camera center in scene units.
        ray: (3,) unit vector from the camera through the middle of the upper box edge.
        position: (3,) in scene units.
        normal: (3,) unit ground normal, towards the cameras.
        offset: () of the ground plane in scene units.

    Returns:
        () in scene units. Always finite: for a vertical ray it is the height of the camera.

    Raises:
        InvalidInputError: if center, ray, position or normal is not one vector.

    Source: paper, Sec. "The Scoring Stage", which names implied heights but gives no formula.
    """
    center, ray, position, normal, offset = float_arrays(
        center=center, ray=ray, position=position, normal=normal, offset=offset
    )
    require_vectors(3, center=center, ray=ray, position=position, normal=normal)
    rise = normal @ ray
    level = ray - rise * normal
    towards = position - center
    squared = level @ level
    # At or below this the ray is vertical to within the rounding of its direction.
    upright = squared <= jnp.square(8 * jnp.finfo(squared.dtype).eps)
    along = jnp.where(upright, 0, level @ towards / jnp.where(upright, 1, squared))
    return jnp.asarray(normal @ center + offset) + jnp.maximum(along, 0) * rise


def heights_by_boxes(
    detections: Detections, localization: Localization, scene: Scene
) -> tuple[Int[np.ndarray, " b"], Int[np.ndarray, " b"], Float[np.ndarray, " b"]]:
    """Compute `implied_height` of the tracked people from each of their boxes.

    Args:
        detections: person boxes of the sequence.
        localization: the result of `cf.localize` for them.
        scene: the scene used for it.

    Returns:
        position: (b,) row of the tracks.
        box: (b,) row of the detections.
        height: (b,) in scene units, possibly negative.

    Raises:
        InvalidInputError: if the localization was made from other detections.
    """
    localization.require_detections(detections)
    tracks, frame = localization.tracks, CanonicalFrame.of(scene)
    rig = frame.rig(scene.rig)
    position, camera = np.nonzero(tracks.support >= 0)
    box = tracks.support[position, camera]
    left, upper, right, _ = detections.box[box].astype(np.float64).T
    top = np.stack([(left + right) / 2, upper], -1)
    ground_xy = frame.to_canonical(tracks.position[position])[:, :2]
    rows = np.asarray(rig.centers)[camera], rays_of_pixels(rig, camera, top), ground_xy
    with jax.enable_x64(True):
        height = in_blocks(_heights_over_zero, rows, BLOCK)
    return position, box, frame.extent * height


@jax.jit
@jax.vmap
def _heights_over_zero(
    center: Float[Array, "3"], ray: Float[Array, "3"], position: Float[Array, "2"]
) -> Float[Array, ""]:
    up, zero = jnp.array([0.0, 0.0, 1.0]), jnp.zeros(())
    return implied_height(center, ray, jnp.append(position, zero), up, zero)
