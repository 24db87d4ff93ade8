"""Cells of the ground before a camera."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, strategies as st

from catfree.methods.evidence.observe._ground_cells import CELLS, ground_cell
from catfree.methods.evidence.observe._views import ground_views
from tests.methods.evidence.evidence_worlds import HEIGHT, make_rig, make_scene

VIEWS = ground_views(make_scene(make_rig(4)), HEIGHT)


@given(st.integers(0, 10**6))
def test_cells_are_squares_ahead_and_aside_of_each_camera(seed):
    rng = np.random.default_rng(seed)
    camera = rng.integers(0, 4, 30)
    ahead, aside = rng.uniform(-20, 150, 30), rng.uniform(-80, 80, 30)
    forward = VIEWS.heading[camera]
    right = np.column_stack([forward[:, 1], -forward[:, 0]])
    place = VIEWS.station[camera] + ahead[:, None] * forward + aside[:, None] * right
    cell = jax.vmap(ground_cell)(*map(jnp.asarray, (place, VIEWS.station[camera], forward)))
    found = np.stack(np.divmod(np.asarray(cell), CELLS), -1)
    # What is outside the map is in the nearest cell.
    expected = np.floor(np.column_stack([ahead + 8, aside + CELLS // 2])).clip(0, CELLS - 1)
    near_a_line = np.abs(np.column_stack([ahead, aside]) % 1 - 0.5).max(1) > 0.5 - 1e-4
    np.testing.assert_array_equal(found[~near_a_line], expected[~near_a_line])
