"""Geometry of the 3-D scenes: camera pyramids, tubes, paths, the ground."""

import numpy as np
from jaxtyping import Float, Int

from catfree.geometry._plane import from_plan
from catfree.geometry.camera import rays_of_pixels
from catfree.types import Localization, Scene, Tracks
from catfree.types._validation import require_instance
from catfree.viz._plan_view import view_area

FRUSTUM_DEPTH = 0.06  # depth of a camera's pyramid, as a share of E
TUBE_RADIUS = 0.003  # radius of a track, as a share of E: 7 cm on a square of usual size
TUBE_SIDES = 8


def frustum_corners(scene: Scene, camera: int, depth: float) -> Float[np.ndarray, "5 3"]:
    """Find the camera center and the four corners of the picture at this depth.

    Args:
        scene: the scene.
        camera: index of a registered camera.
        depth: distance from the center along the optical axis in scene units.

    Returns:
        (5, 3) world points; corners run from the top left one clockwise around the picture.
    """
    rig = scene.rig
    width, height = (float(side) - 0.5 for side in rig.image_size[camera])
    corners = np.array([[-0.5, -0.5], [width, -0.5], [width, height], [-0.5, height]])
    ray = rays_of_pixels(rig, camera, corners)
    axis = np.asarray(rig.R, np.float64)[camera, 2]
    center = np.asarray(rig.centers, np.float64)[camera]
    # The border rays of a very wide lens may point sideways and never reach that depth.
    along = np.maximum(ray @ axis, 0.05)
    return np.vstack([center, center + depth * ray / along[:, None]])


def tube(
    points: Float[np.ndarray, "n 3"], radius: float, up: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Build a closed tube around a polyline that lies in a plane.

    trimesh offers a cylinder per step, which takes a second per two thousand steps, or a sweep,
    which needs another package.

    Args:
        points: (N, 3) at least two points, successive ones distinct.
        radius: radius of the tube, in the units of the points.
        up: (3,) unit normal of the plane.

    Returns:
        Vertices (V, 3), the first N * TUBE_SIDES of them on rings around the points, and
        triangles (F, 3).
    """
    step = np.diff(points, axis=0)
    step = step / np.linalg.norm(step, axis=-1, keepdims=True)
    tangent = np.vstack([step[:1], step[:-1] + step[1:], step[-1:]])
    side = np.cross(up, tangent)
    length = np.linalg.norm(side, axis=-1, keepdims=True)
    turned = np.cross(up, np.vstack([step, step[-1:]]))  # where the track reverses
    side = np.where(length > 1e-6, side / np.maximum(length, 1e-6), turned)
    angle = 2 * np.pi * np.arange(TUBE_SIDES) / TUBE_SIDES
    ring = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up
    rings = (points[:, None] + radius * ring).reshape(-1, 3)
    count, k = len(points), TUBE_SIDES
    corner = (np.arange(count - 1)[:, None] * k + np.arange(k)).ravel()
    following = (np.arange(count - 1)[:, None] * k + np.roll(np.arange(k), -1)).ravel()
    walls = np.concatenate(
        [
            np.stack([corner, following, corner + k], -1),
            np.stack([following, following + k, corner + k], -1),
        ]
    )
    first, last = len(rings), len(rings) + 1
    rim, turn = np.arange(k), np.roll(np.arange(k), -1)
    caps = np.concatenate(
        [
            np.stack([np.full(k, first), turn, rim], -1),
            np.stack([np.full(k, last), rim + (count - 1) * k, turn + (count - 1) * k], -1),
        ]
    )
    return np.vstack([rings, points[:1], points[-1:]]), np.concatenate([walls, caps])


def track_lines(tracks: Tracks) -> dict[int, Float[np.ndarray, "n 3"]]:
    """Return the path (N, 3) of each identity in scene units, without frames of standing still.

    Tracks that never move are left out.
    """
    lines = {}
    for identity in np.unique(tracks.track_id[tracks.track_id >= 0]).tolist():
        line = tracks.position[tracks.track_id == identity]
        moved = np.concatenate([[True], (np.diff(line, axis=0) != 0).any(-1)])
        if moved.sum() >= 2:
            lines[identity] = line[moved]
    return lines


def tracks_of(localization: Localization | None) -> Tracks:
    """Return the tracks of a run; empty tracks for None."""
    if localization is not None:
        require_instance(localization, Localization, "localization")
        return localization.tracks
    integers, floats = np.zeros(0, np.int64), np.zeros(0)
    points = np.zeros((0, 3)), np.zeros((0, 2))
    return Tracks(integers, integers, *points, floats, np.zeros((0, 2, 2)), integers, integers)


def ground_corners(scene: Scene, tracks: Tracks) -> Float[np.ndarray, "4 3"]:
    """Find the corners (4, 3) of a rectangle of ground below all cameras and tracks."""
    x_min, x_max, y_min, y_max = view_area(scene, tracks.ground_xy)
    return from_plan(
        scene, np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]])
    )
