"""One box as a measurement of (ground position, height)."""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.geometry._buckets import in_blocks
from catfree.geometry._person import (
    NEAREST_DEPTH,
    box_edges,
    box_ends,
    drop_to_height,
    edge_deviation,
    edges_and_slopes,
    height_at,
    visible_foot,
)
from catfree.methods.evidence._gaussian import Information, invert_symmetric, mean_and_covariance
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._ground_cells import ground_cell
from catfree.methods.evidence.observe._views import GroundViews
from catfree.settings import EvidenceSettings
from catfree.settings._calibration_settings import FOOT_AHEAD
from catfree.types._annotations import HostOrDevice


class Noise(eqx.Module):
    """Noise and population parameters learned from the sequence.

    Attributes:
        edge: (C, 3) noise of center, top and bottom as a fraction of the box height.
        angular: () angular noise common to all boxes, in radians.
        field: (C, 3, 4) offset of each edge: coefficients of focal length, column, row and box
            height.
        spread: () standard deviation of heights in H0.
        density: () people per H0².
    """

    edge: Float[np.ndarray, "cam 3"]
    angular: Float[np.ndarray, ""]
    field: Float[np.ndarray, "cam 3 4"]
    spread: Float[np.ndarray, ""]
    density: Float[np.ndarray, ""]


class Measurements(eqx.Module):
    """Boxes as Gaussian likelihoods of (y1, y2, H) in units of H0.

    Attributes:
        info: (N) information without the height prior; 0 where not valid.
        noise: (N, 3) standard deviation of each edge in pixels.
        used: (N, 3) whether an edge carries information.
        cell: (N,) cell of the camera's map (see `ground_cell`) where the box alone places a person.
        valid: (N,) whether the measurement is usable.
    """

    info: Information
    noise: Float[HostOrDevice, "*box 3"]
    used: Bool[HostOrDevice, "*box 3"]
    cell: Int[HostOrDevice, "*box"]
    valid: Bool[HostOrDevice, "*box"]


class BoxConstants(NamedTuple):
    """The settings of `measure`, passed as values so that a change does not recompile."""

    ankle_factor: float
    cover_slope: float
    cover_ramp: tuple[float, float]
    side_cut_noise: float
    foot_outlier: float
    largest_sigma: float
    use_height: bool

    @classmethod
    def of(cls, settings: EvidenceSettings) -> "BoxConstants":
        """Select the constants from the settings."""
        return cls(*(getattr(settings, name) for name in cls._fields))


BLOCK = 256  # boxes measured together; an instant of a running tracker is one block
NEWTON_STEPS = 6  # Gauss-Newton steps of a box; three or four converge
EXPLAINED = 6.0  # standard deviations; larger residuals mean that Gauss-Newton diverged
FOOT_ROUNDS = 2  # iterations of the foot column; the second changes it by the roll squared
HEIGHT_BOUNDS = (0.1, 4.0)  # H0; bounds of the height while the foot column is estimated
LARGEST_LEAN = 0.5  # box heights; largest change of the foot column per round
LEAST_TRUST = 1e-4  # in a bottom edge; 100 times the usual noise carries no information


def start_noise(cameras: int, settings: EvidenceSettings) -> Noise:
    """Initial noise, before learning."""
    return Noise(
        edge=np.tile(np.array(settings.edge_noise), (cameras, 1)),
        angular=np.array(settings.angular_noise),
        field=np.zeros((cameras, 3, 4)),
        spread=np.array(np.sqrt(np.prod(settings.height_spread_range))),
        density=np.array(settings.density_start),
    )


def field_features(
    edges: Float[HostOrDevice, "*n 3"],
    size: Float[HostOrDevice, "*n"],
    focal: Float[HostOrDevice, "*n"],
    center: Float[HostOrDevice, "*n 2"],
) -> Any:
    """Features (3, 4) of each edge's systematic offset: focal length, column, row, box height."""
    xp = edges.__array_namespace__()
    column, top, bottom = (edges[..., i] for i in range(3))
    rows = xp.stack([(top + bottom) / 2, top, bottom], -1)
    flat = xp.ones_like(rows)
    # The center column does not depend on the box height.
    height = xp.stack([xp.zeros_like(size), size, size], -1)
    along = (column - center[..., 0])[..., None]
    return xp.stack([focal[..., None] * flat, along * flat, rows - center[..., 1:], height], -1)


def features_of(
    boxes: Boxes, rows: Int[np.ndarray, " n"], views: GroundViews
) -> Float[np.ndarray, "n 3 4"]:
    """Return `field_features` of some of the boxes."""
    view = boxes.view[rows]
    return field_features(
        boxes.edges[rows], boxes.size[rows], views.focal[view], views.center[view]
    )


class Box(NamedTuple):
    """One box or, with a leading axis, many.

    Attributes:
        edges: (3,) center column, top and bottom row, undistorted pixels.
        size: () height in pixels.
        cut: (3,) whether side, top and bottom are cut by the image border.
        ankles: () whether the ankles are confirmed.
        covered: () fraction of the lower box hidden by boxes in front.
    """

    edges: Float[HostOrDevice, "*box 3"]
    size: Float[HostOrDevice, "*box"]
    cut: Bool[HostOrDevice, "*box 3"]
    ankles: Bool[HostOrDevice, "*box"]
    covered: Float[HostOrDevice, "*box"]


class Pinhole(NamedTuple):
    """The camera of a box, and its noise; with a leading axis, those of many boxes.

    Attributes:
        matrix: (3, 4) projection, see `GroundViews`.
        ground_inverse: (3, 3) map from a pixel to a foot.
        head_inverse: (3, 3) map from a pixel to a head at H0.
        focal: () focal length in pixels.
        center: (2,) principal point.
        station: (2,) the camera center projected onto the plane, in H0.
        heading: (2,) viewing direction of the camera, not of a box's own pinhole, on the plane.
        edge_noise: (3,) noise of the edges in box heights.
        field: (3, 4) offset coefficients of the edges.
    """

    matrix: Float[Array, "*box 3 4"]
    ground_inverse: Float[Array, "*box 3 3"]
    head_inverse: Float[Array, "*box 3 3"]
    focal: Float[Array, "*box"]
    center: Float[Array, "*box 2"]
    station: Float[Array, "*box 2"]
    heading: Float[Array, "*box 2"]
    edge_noise: Float[Array, "*box 3"]
    field: Float[Array, "*box 3 4"]


def implied_person(
    matrix: Float[HostOrDevice, "3 4"],
    ground_inverse: Float[HostOrDevice, "3 3"],
    station: Float[HostOrDevice, "2"],
    edges: Float[HostOrDevice, "3"],
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Position and height of a person whose box has exactly these edges."""

    def stand(column: Float[Array, ""]) -> Float[Array, "2"]:
        foot = drop_to_height(ground_inverse, jnp.stack([column, edges[2]]))
        return jnp.stack(visible_foot(foot, station, -FOOT_AHEAD))

    column = edges[0]
    for _ in range(FOOT_ROUNDS):  # in a rolled camera, the foot is not below the box center
        position = stand(column)
        height = jnp.clip(height_at(matrix, position, edges[1]), *HEIGHT_BOUNDS)
        predicted = box_edges(matrix, jnp.append(position, height), station, FOOT_AHEAD)
        limit = LARGEST_LEAN * (edges[2] - edges[1])
        column = column + jnp.clip(edges[0] - predicted[0], -limit, limit)
    position = stand(column)
    return position, height_at(matrix, position, edges[1])


def measure(
    box: Box,
    camera: Pinhole,
    angular: Float[HostOrDevice, ""],
    spread: Float[HostOrDevice, ""],
    constants: BoxConstants,
) -> Measurements:
    """Compute the likelihood of one box.

    Args:
        box: the box.
        camera: the camera that sees it.
        angular: () calibration error in radians.
        spread: () standard deviation of heights in H0.
        constants: see `EvidenceSettings`.

    Returns:
        The measurement; valid if a person explains the box and the place is precise enough.
    """
    matrix, cut = camera.matrix, box.cut
    dtype = box.edges.dtype
    features = field_features(box.edges, box.size, camera.focal, camera.center)
    edges = box.edges - (features * camera.field).sum(-1)
    usual = camera.edge_noise
    share = usual.at[0].set(jnp.where(cut[0], constants.side_cut_noise, usual[0]))
    free, full = constants.cover_ramp
    hidden = 1 + constants.cover_slope * (jnp.clip(box.covered, free, full) - free)
    share = share.at[2].multiply(jnp.where(box.ankles, 1.0, constants.ankle_factor) * hidden)

    position, height = implied_person(matrix, camera.ground_inverse, camera.station, edges)
    deviation = jnp.sqrt(spread**2 + (usual[1] ** 2 + usual[2] ** 2))
    density = jnp.exp(-0.5 * ((height - 1) / deviation) ** 2) / (
        deviation * jnp.sqrt(jnp.array(2 * jnp.pi, dtype))
    )
    good = (1 - constants.foot_outlier) * density
    trust = good / (good + constants.foot_outlier)
    whole = ~cut[1] & ~cut[2]
    trust = jnp.where(whole & constants.use_height, jnp.clip(trust, LEAST_TRUST, 1.0), 1.0)
    share = share.at[2].multiply(1 / jnp.sqrt(trust))
    noise = edge_deviation(box.size, share, angular * camera.focal)

    used = jnp.stack([jnp.ones((), bool), ~cut[1] & constants.use_height, ~cut[2]])
    precision = jnp.where(used, 1 / noise**2, 0.0)

    head = drop_to_height(camera.head_inverse, edges[:2])
    by_head = (cut[2] | (trust < 0.5)) & ~cut[1]
    start = jnp.append(jnp.where(by_head, head, position), jnp.ones((), dtype))
    prior = jnp.array([0.0, 0.0, 1.0], dtype) / spread**2

    def step(state, _):
        predicted, slopes = edges_and_slopes(matrix, state, camera.station, FOOT_AHEAD)
        weighted = slopes * precision[:, None]
        normal = weighted.T @ slopes + jnp.diag(prior)
        gradient = weighted.T @ (edges - predicted) + prior * (1 - state)
        normal = normal + 1e-9 * jnp.trace(normal) * jnp.eye(3, dtype=dtype)
        return state + invert_symmetric(normal) @ gradient, None

    state, _ = jax.lax.scan(step, start, None, length=NEWTON_STEPS)
    predicted, slopes = edges_and_slopes(matrix, state, camera.station, FOOT_AHEAD)
    residual = edges - predicted + slopes @ state
    weighted = slopes * precision[:, None]
    normal = weighted.T @ slopes
    normal = (normal + normal.T) / 2  # rounding breaks the symmetry
    info = Information(normal, weighted.T @ residual, (precision * residual**2).sum())
    place, covariance = mean_and_covariance(info, spread)
    _, _, nearest = box_ends(matrix, state, camera.station, FOOT_AHEAD)
    finite = jnp.isfinite(state).all() & jnp.isfinite(normal).all() & jnp.isfinite(info.constant)
    # Steps that reach the camera's plane produce unbounded slopes, which would outweigh all other
    # boxes of a group. A box is therefore valid only if its state explains it.
    explained = jnp.where(used, jnp.abs(edges - predicted) <= EXPLAINED * noise, True).all()
    valid = finite & (nearest > NEAREST_DEPTH) & explained & ~(cut[1] & cut[2])
    sigma = jnp.sqrt((covariance[0, 0] + covariance[1, 1]) / 2)
    valid &= jnp.isfinite(sigma) & (sigma < constants.largest_sigma)
    cell = jnp.where(valid, ground_cell(place[:2], camera.station, camera.heading), 0)
    return Measurements(info, noise, used, cell, valid)


@jax.jit
def measure_all(
    box: Box,
    camera: Int[HostOrDevice, " box"],
    view: Int[HostOrDevice, " box"],
    present: Bool[HostOrDevice, " box"],
    views: GroundViews,
    noise: Noise,
    constants: BoxConstants,
) -> Measurements:
    """Apply `measure` to every box that is present."""
    seen_by = Pinhole(
        matrix=views.matrix[view],
        ground_inverse=views.ground_inverse[view],
        head_inverse=views.head_inverse[view],
        focal=views.focal[view],
        center=views.center[view],
        station=views.station[view],
        heading=views.heading[camera],
        edge_noise=noise.edge[camera],
        field=noise.field[camera],
    )
    measured = jax.vmap(measure, (0, 0, None, None, None))(
        box, seen_by, noise.angular, noise.spread, constants
    )
    valid = measured.valid & present

    def keep(values: HostOrDevice) -> Array:
        return jnp.where(valid.reshape(-1, *(1,) * (values.ndim - 1)), values, 0.0)

    return replace(measured, info=jax.tree.map(keep, measured.info), valid=valid)


def measure_boxes(
    boxes: Boxes,
    views: GroundViews,
    noise: Noise,
    settings: EvidenceSettings,
) -> Measurements:
    """Compute the likelihoods of all boxes of a sequence, on the host in double precision."""
    constants = BoxConstants.of(settings)
    box = Box(boxes.edges, boxes.size, boxes.cut, boxes.ankles, boxes.covered)
    measured = in_blocks(
        lambda *part: measure_all(*part, views, noise, constants),
        (box, boxes.camera, boxes.view, boxes.valid),
        BLOCK,
    )
    wide = lambda a: a.astype(np.float64, copy=False) if a.dtype.kind == "f" else a  # noqa: E731
    return jax.tree.map(wide, measured)
