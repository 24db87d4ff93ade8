"""The box of a standing person: a vertical segment (x, y, height) on the ground z = 0."""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

NEAREST_DEPTH = 0.1  # of the third homogeneous coordinate: points nearer are projected from there


def box_edges(
    matrix: Float[Array, "3 4"],
    station: Float[Array, "2"],
    person: Float[Array, "3"],
    foot_offset: Float[Array, ""] | float,
    lens: Callable[[Float[Array, "2"]], Float[Array, "2"]] | None = None,
) -> Float[Array, "3"]:
    """Predict the edges of the box of a standing person.

    The visible foot is nearer to the camera than the axis of the body, whose top is the head.

    Args:
        matrix: (3, 4) projection of homogeneous points over the ground; the third coordinate of the
            result is the depth, in units of the ground.
        station: (2,) the camera's center, projected onto the ground.
        person: (3,) position on the ground and height.
        foot_offset: distance by which the foot is nearer.
        lens: map (2,) of the projected points to pixels; they are pixels if None.

    Returns:
        (3,) center column, head row and foot row in pixels.
    """
    x, y, height = person
    dx, dy = x - station[0], y - station[1]
    nearer = foot_offset / jnp.sqrt(jnp.maximum(dx**2 + dy**2, 1e-12))
    pixels = []
    for end in ((x, y, height), (x - nearer * dx, y - nearer * dy, 0.0)):
        column, row, depth = (m[0] * end[0] + m[1] * end[1] + m[2] * end[2] + m[3] for m in matrix)
        depth = jnp.maximum(depth, NEAREST_DEPTH)
        pixel = jnp.stack([column / depth, row / depth])
        pixels.append(pixel if lens is None else lens(pixel))
    (head_column, head_row), (foot_column, foot_row) = pixels
    return jnp.stack([(head_column + foot_column) / 2, head_row, foot_row])
