"""A camera as a coarse grid of rays over its image, for any lens with smooth rays."""

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Real

from catfree.geometry._arrays import epsilon, float_arrays, require_vectors, safe_norm
from catfree.types._annotations import HostOrDevice

STEPS = 12  # Newton steps of the inverse; convergence is quadratic from a nearby node
STARTS = 32  # about as many rows and columns of nodes are tried as its start
FOUND = 1e-4  # radians; largest angle between a point and the ray of its pixel
TOLERANCE = 0.1  # of the inverse in cells, in roots of the machine epsilon; a last step follows
SINGULAR = 1e-9  # least determinant of the rays' change per cell: a pole of the image


def grid_ray(
    grid: Real[HostOrDevice, "row column 3"],
    image_size: Real[HostOrDevice, "2"],
    pixel: Real[HostOrDevice, "2"],
) -> Float[Array, "3"]:
    """Find the direction in which a camera sees at a pixel, interpolated on a grid of rays.

    The nodes are evenly spaced from the outer edge of the first row and column (-0.5) to the outer
    edge of the last ones (height - 0.5, width - 0.5). Up to one cell outside, rays are
    extrapolated.

    Args:
        grid: (rows, columns, 3) unit vectors in camera axes, at least three rows and columns.
        image_size: (2,) width and height in pixels.
        pixel: (2,) in original image pixels.

    Returns:
        (3,) unit vector in camera axes.

    Raises:
        InvalidInputError: if pixel is not one vector.

    Source: Keys (1981), cubic convolution with quadratic extrapolation at the border.
    """
    rays, size, at = float_arrays(grid=grid, image_size=image_size, pixel=pixel)
    require_vectors(2, image_size=size, pixel=at)
    return _interpolate(_extend(rays), _to_cells(rays, size, at))


def grid_pixel(
    grid: Real[HostOrDevice, "row column 3"],
    image_size: Real[HostOrDevice, "2"],
    point: Real[HostOrDevice, "3"],
) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """Find the pixel at which a camera sees a point: invert `grid_ray` by root finding.

    Args:
        grid: (rows, columns, 3) unit vectors in camera axes, as in `grid_ray`.
        image_size: (2,) width and height in pixels.
        point: (3,) in camera axes, any unit.

    Returns:
        pixel: (2,) in original image pixels, at most one cell outside the image; always finite.
        imaged: () whether the ray of the pixel meets the point. False for points that no pixel of
            the image sees, and where many pixels share one ray.

    Where a point has two pixels, as at the seam of a panorama, one of them is returned.

    Raises:
        InvalidInputError: if point is not one vector.
    """
    rays, size, xyz = float_arrays(grid=grid, image_size=image_size, point=point)
    require_vectors(2, image_size=size)
    require_vectors(3, point=xyz)
    extended = _extend(rays)
    distance = safe_norm(xyz)
    somewhere = distance > 0
    fallback = rays[rays.shape[0] // 2, rays.shape[1] // 2]
    direction = jnp.where(somewhere, xyz / jnp.where(somewhere, distance, 1), fallback)
    least = jnp.argmin(jnp.abs(direction))
    first = jnp.cross(direction, jnp.eye(3, dtype=rays.dtype)[least])
    first = first / safe_norm(first)
    sideways = jnp.stack([first, jnp.cross(direction, first)])

    def miss(cells: Array, sideways: Array) -> Array:
        return sideways @ _interpolate(extended, cells)

    strides = tuple(max(1, count // STARTS) for count in rays.shape[:2])
    coarse = rays[:: strides[0], :: strides[1]]
    nearest = jnp.argmax(coarse.reshape(-1, 3) @ direction)
    row, column = jnp.divmod(nearest, coarse.shape[1])
    start = jnp.stack([strides[1] * column, strides[0] * row]).astype(rays.dtype)
    upper = jnp.asarray(rays.shape[1::-1], rays.dtype)
    tolerance = TOLERANCE * epsilon(rays.dtype) ** 0.5
    root = optx.root_find(
        miss,
        optx.Newton(rtol=tolerance, atol=tolerance),
        start,
        jax.lax.stop_gradient(sideways),
        options={"lower": -jnp.ones(2, rays.dtype), "upper": upper},
        max_steps=STEPS,
        throw=False,
    ).value
    root = jax.lax.stop_gradient(jnp.where(jnp.isfinite(root).all(), root, start))
    # One more step, whose derivative is that of the root by the implicit function theorem.
    error = miss(root, sideways)
    slope = jax.lax.stop_gradient(jax.jacfwd(miss)(root, sideways))
    determinant = slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0]
    regular = jnp.abs(determinant) > SINGULAR
    adjugate = jnp.stack([jnp.stack([slope[1, 1], -slope[0, 1]]),
                          jnp.stack([-slope[1, 0], slope[0, 0]])])  # fmt: skip
    cells = root - jnp.where(regular, 1, 0) * (adjugate @ error) / jnp.where(
        regular, determinant, 1
    )
    cells = jnp.clip(cells, -1, upper)
    ray = _interpolate(extended, cells)
    met = (safe_norm(sideways @ ray) < FOUND) & (direction @ ray > 0)
    return _from_cells(rays, size, cells), somewhere & regular & met


def _to_cells(grid: Array, image_size: Array, pixel: Array) -> Float[Array, "2"]:
    """Column and row in units of the grid's nodes."""
    last = jnp.asarray([grid.shape[1] - 1, grid.shape[0] - 1], grid.dtype)
    return (pixel + 0.5) / image_size * last


def _from_cells(grid: Array, image_size: Array, cells: Array) -> Float[Array, "2"]:
    last = jnp.asarray([grid.shape[1] - 1, grid.shape[0] - 1], grid.dtype)
    return cells / last * image_size - 0.5


def _extend(grid: Float[Array, "row column 3"]) -> Float[Array, "row+2 column+2 3"]:
    """Add a node on each side, extrapolated by a parabola."""
    for axis in (0, 1):
        nodes = jnp.moveaxis(grid, axis, 0)
        before = 3 * nodes[0] - 3 * nodes[1] + nodes[2]
        after = 3 * nodes[-1] - 3 * nodes[-2] + nodes[-3]
        grid = jnp.moveaxis(jnp.concatenate([before[None], nodes, after[None]]), 0, axis)
    return grid


def _interpolate(extended: Float[Array, "row column 3"], cells: Array) -> Float[Array, "3"]:
    """Unit vector at (column, row) in units of the grid's own nodes."""
    rows, columns = extended.shape[0] - 2, extended.shape[1] - 2
    corner = jnp.floor(jax.lax.stop_gradient(cells))
    corner = jnp.clip(corner, 0, jnp.asarray([columns - 2, rows - 2], cells.dtype))
    share = jnp.clip(cells - corner, -1, 2)
    at = corner.astype(int)
    patch = jax.lax.dynamic_slice(extended, (at[1], at[0], jnp.zeros_like(at[0])), (4, 4, 3))
    ray = jnp.einsum("i,j,ijk->k", _weights(share[1]), _weights(share[0]), patch)
    length = safe_norm(ray)
    return ray / jnp.where(length > 0, length, 1)


def _weights(share: Array) -> Float[Array, "4"]:
    """Weights of the nodes at -1, 0, 1, 2 for a position between 0 and 1."""
    s, s2, s3 = share, share**2, share**3
    return 0.5 * jnp.stack([-s + 2 * s2 - s3, 2 - 5 * s2 + 3 * s3, s + 4 * s2 - 3 * s3, s3 - s2])
