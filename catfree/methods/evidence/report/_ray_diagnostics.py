"""Diagnostics of each group from foot rays alone, without the assumed ground.

The method places people on the ground. The intersection of a person's foot rays is a second
opinion: if it is above or below the ground, the ground is wrong; if there is none, the cameras are.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.geometry import (
    angular_residual,
    ground_sigma,
    information,
    plane_distance,
    triangulate_least_squares,
)
from catfree.geometry._buckets import in_blocks
from catfree.geometry._person import visible_foot
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._measurement import Measurements
from catfree.methods.evidence.observe._views import GroundViews
from catfree.settings._calibration_settings import FOOT_AHEAD
from catfree.types import Plane

BLOCK = 256  # groups diagnosed together in all cameras
FEWEST = 20  # heights needed to tell a wrong ground from noise


class RayDiagnostics(NamedTuple):
    """Foot rays of each group, intersected by least squares; in units of H0.

    Attributes:
        sigma: (H,) ground uncertainty by Eq. sigma; infinite with fewer than two rays.
        height: (H,) signed height of the intersection above the ground; NaN where sigma is not
            finite.
        rms_angle: (H,) RMS angle in radians between the rays and the intersection; NaN likewise.
    """

    sigma: Float[np.ndarray, " group"]
    height: Float[np.ndarray, " group"]
    rms_angle: Float[np.ndarray, " group"]

    def ground_height(self, chosen: Bool[np.ndarray, " group"]) -> float:
        """Median height of the chosen groups (H,); NaN if fewer than `FEWEST` of them have one."""
        height = self.height[chosen & np.isfinite(self.height)]
        return float(np.median(height)) if len(height) >= FEWEST else float("nan")


@jax.jit
@jax.vmap
def _diagnose(
    origins: Float[Array, "cam 3"],
    directions: Float[Array, "cam 3"],
    weights: Float[Array, " cam"],
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    ground = Plane(np.array([0.0, 0.0, 1.0]), 0.0)  # in `GroundViews` coordinates
    position = triangulate_least_squares(origins, directions, weights)
    sigma = ground_sigma(information(position, origins, directions, weights, 1.0), ground)
    height = jnp.sign(position[2]) * plane_distance(ground, position)
    angle = jax.vmap(angular_residual, (None, 0, 0))(position, origins, directions)
    present = weights > 0
    rms_angle = jnp.sqrt(jnp.mean(angle**2, where=present))
    known = jnp.isfinite(sigma)
    return sigma, jnp.where(known, height, jnp.nan), jnp.where(known, rms_angle, jnp.nan)


def ray_diagnostics(
    boxes: Boxes, measured: Measurements, groups: Groups, views: GroundViews
) -> RayDiagnostics:
    """Intersect the foot rays of each group, shifted from the visible foot to below the body.

    Args:
        boxes: the boxes; the bottom centers as observed, without learned offsets.
        measured: the noise of their bottom edges; a bottom edge without information has no ray.
        groups: boxes of one person in one frame.
        views: the cameras.

    Returns:
        One value per group.

    Source: paper, Eq. sigma and Sec. "Selecting pedestrian positions".
    """
    inverse = np.linalg.inv(views.matrix[:, :, :3])
    cameras = slice(len(views.registered))
    origins = -np.einsum("cij,cj->ci", inverse[cameras], views.matrix[cameras, :, 3])

    def diagnose(member: Int[np.ndarray, "group cam"]) -> tuple[Array, Array, Array]:
        row = np.maximum(member, 0)
        edges, view = boxes.edges[row], boxes.view[row]
        foot = np.stack([edges[..., 0], edges[..., 2], np.ones(row.shape)], -1)
        direction = np.einsum("gcij,gcj->gci", inverse[view], foot)
        # The visible foot is nearer than the body, so the ray moves outward by that distance on the
        # ground.
        fall = np.maximum(-direction[..., 2], 0) / origins[boxes.camera[row], 2]
        level = visible_foot(direction[..., :2], np.zeros(2), -FOOT_AHEAD * fall)
        direction[..., :2] = np.stack(level, -1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        angle = measured.noise[row, 2] / views.focal[view]
        usable = (member >= 0) & boxes.valid[row] & measured.used[row, 2] & (angle > 0)
        weights = np.where(usable, 1 / np.where(usable, angle, 1) ** 2, 0.0)
        return _diagnose(np.broadcast_to(origins, direction.shape), direction, weights)

    return RayDiagnostics(*in_blocks(diagnose, (groups.member,), BLOCK))
