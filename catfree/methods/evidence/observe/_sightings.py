"""Predicted and actual boxes of people, camera by camera."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from catfree.geometry._buckets import in_blocks
from catfree.geometry._person import box_edges
from catfree.methods.evidence.observe._measurement import Measurements
from catfree.methods.evidence.observe._views import GroundViews
from catfree.settings._calibration_settings import FOOT_AHEAD

BLOCK = 256  # boxes predicted together; an instant of a running tracker is one block


class Sightings(NamedTuple):
    """The people seen by one camera.

    Attributes:
        person: (n,) index of each person.
        box: (n,) row of the person's box.
        edges: (n, 3) predicted center column, top and bottom row in pixels.
        slopes: (n, 3, 4) their derivatives with respect to (y1, y2, H) and z, the height of the
            feet above the plane.
        precision: (n, 3) inverse standard deviations of the edges of the boxes, 0 for unused ones.
    """

    person: Int[np.ndarray, " n"]
    box: Int[np.ndarray, " n"]
    edges: Float[np.ndarray, "n 3"]
    slopes: Float[np.ndarray, "n 3 4"]
    precision: Float[np.ndarray, "n 3"]


def sightings_by_camera(
    state: Float[np.ndarray, "person 3"],
    member: Int[np.ndarray, "person cam"],
    measurements: Measurements,
    view: Int[np.ndarray, " box"],
    views: GroundViews,
) -> Iterator[Sightings]:
    """Predict the boxes of people one camera at a time, because all slopes together would be large.

    The float width is JAX's at the time of iteration.

    Args:
        state: (P, 3) positions and heights in H0 of P people.
        member: (P, C) the box of each person in each camera, -1 for none.
        measurements: the noise of the boxes.
        view: (N,) the pinhole of each box.
        views: the cameras.

    Yields:
        The sightings of each camera, in order.
    """
    for column in member.T:
        person = np.flatnonzero(column >= 0)
        box = column[person]
        matrix, station = views.matrix[view[box]], views.station[view[box]]
        edges, slopes = predicted_edges(state[person], matrix, station)
        precision = np.where(measurements.used[box], 1 / measurements.noise[box], 0.0)
        yield Sightings(person, box, edges, slopes, precision)


def predicted_edges(
    state: Float[np.ndarray, "n 3"],
    matrix: Float[np.ndarray, "n 3 4"],
    station: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 4"]]:
    """Predict the edges of people's boxes, and their slopes; see `Sightings`.

    Args:
        state: (n, 3) positions and heights in H0.
        matrix: (n, 3, 4) projection of the pinhole that sees each person.
        station: (n, 2) its center projected onto the plane.
    """
    return in_blocks(_edges_and_slopes, (state, matrix, station), BLOCK)


@jax.jit
@jax.vmap
def _edges_and_slopes(
    state: Float[Array, "3"], matrix: Float[Array, "3 4"], station: Float[Array, "2"]
) -> tuple[Float[Array, "3"], Float[Array, "3 4"]]:
    def edges(raised: Float[Array, "4"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        higher = matrix.at[:, 3].add(raised[3] * matrix[:, 2])
        shown = box_edges(higher, raised[:3], station, FOOT_AHEAD)
        return shown, shown

    slopes, shown = jax.jacfwd(edges, has_aux=True)(jnp.append(state, 0))
    return shown, slopes
