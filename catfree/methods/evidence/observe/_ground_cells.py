"""Grid cells of the ground in front of each camera, in which its clutter is counted."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

CELLS = 128  # side of each camera's map, in H0
BEHIND = 8  # cells behind the camera, where rig errors may place a person


def ground_cell(
    place: Float[Array, "2"], station: Float[Array, "2"], heading: Float[Array, "2"]
) -> Int[Array, ""]:
    """Index of the 1 H0² cell of a place in a camera's map.

    Args:
        place: (2,) on the plane in H0.
        station: (2,) the camera center projected onto the plane, in H0.
        heading: (2,) unit viewing direction of the camera on the plane.

    Returns:
        () row times `CELLS` plus column; places outside the map go to the nearest cell.
    """
    ahead = heading @ (place - station)
    aside = jnp.stack([heading[1], -heading[0]]) @ (place - station)
    cell = jnp.floor(jnp.stack([ahead + BEHIND, aside + CELLS // 2]))
    row, column = jnp.clip(cell, 0, CELLS - 1).astype(int)
    return row * CELLS + column
