"""The fit to anchors against its normal equations, which it never forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import block_diag

from catfree.calibration.people.anchors._measurements import (
    HEIGHT,
    PEOPLE,
    POINT,
    POSITION,
    ROTATION,
    Measurement,
    linearize,
    stack,
)
from catfree.calibration.people.anchors._mixed_model import fit_mixed_model

pytestmark = pytest.mark.slow

CAMERAS = 2
FREE = np.ones(4, bool)


def drawn(seed):
    """Draw cameras with a covariance, and measurements in a map frame, with errors."""
    rng = np.random.default_rng(seed)
    cameras = np.column_stack(
        [np.full(CAMERAS, 7.0), np.full(CAMERAS, 0.5), *rng.uniform(-0.2, 0.2, (2, CAMERAS)),
         *rng.uniform(-3, 3, (2, CAMERAS)), np.full(CAMERAS, 4.0)]
    )  # fmt: skip
    root = 0.01 * rng.normal(size=(cameras.size, cameras.size))
    frame = np.array([*rng.normal(scale=0.05, size=2), *rng.uniform(-5, 5, 2)])
    kinds = [POINT, POINT, POINT, POSITION, HEIGHT, ROTATION, PEOPLE]
    sizes = {POINT: 2, POSITION: 3, ROTATION: 3}
    made = [
        Measurement(
            None, kind, int(rng.integers(CAMERAS)), rng.uniform([-500, -100], [500, 350], (2, 2)),
            np.zeros(sizes.get(kind, 1)), 0.02, 1.0,
        )
        for kind in kinds
    ]  # fmt: skip
    with jax.enable_x64(True):
        off = np.asarray(linearize(stack(made), jnp.asarray(cameras), jnp.asarray(frame)).off)
    stated = [
        m._replace(value=-off[i, : len(m.value)] + 0.01 * rng.normal(size=len(m.value)))
        for i, m in enumerate(made)
    ]
    return stated, cameras, root @ root.T, frame


def fitted(stated, used, cameras, prior, start, free=FREE):
    with jax.enable_x64(True):
        rows = stack(stated)
        mask = np.zeros(len(rows.kind), bool)
        mask[: len(used)] = used
        given = (jnp.asarray(a) for a in (mask, cameras, prior, start, free))
        return jax.tree.map(np.asarray, fit_mixed_model(rows, *given))


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_the_fit_and_its_covariance_solve_the_normal_equations(seed):
    stated, cameras, prior, frame = drawn(seed)
    fit = fitted(stated, np.ones(len(stated), bool), cameras, prior, frame + 0.1)
    present = np.asarray(stack(stated).present).ravel()
    J = fit.compared.slopes.reshape(len(present), -1)[present]
    noise = block_diag(*fit.compared.noise)[np.ix_(present, present)]
    information = J.T @ np.linalg.solve(noise, J)
    information[: cameras.size, : cameras.size] += np.linalg.inv(prior)
    np.testing.assert_allclose(fit.covariance @ information, np.eye(len(J.T)), atol=1e-5)
    pull = J.T @ np.linalg.solve(noise, fit.compared.off.ravel()[present])
    pull[: cameras.size] -= np.linalg.solve(prior, (fit.cameras - cameras).ravel())
    step = np.linalg.solve(information, pull)
    np.testing.assert_allclose(step, 0, atol=1e-7)


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.integers(0, 6))
def test_measurements_not_in_use_change_nothing(seed, absent):
    stated, cameras, prior, frame = drawn(seed)
    used = np.arange(len(stated)) != absent
    wild = [m if u else m._replace(value=m.value + 1e3) for m, u in zip(stated, used, strict=True)]
    rest = [m for m, u in zip(stated, used, strict=True) if u]
    one = fitted(wild, used, cameras, prior, frame)
    other = fitted(rest, np.ones(len(rest), bool), cameras, prior, frame)
    for name in ("cameras", "frame", "covariance", "misfit"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-7, atol=1e-9)


def test_entries_of_the_frame_that_are_not_free_stay():
    stated, cameras, prior, _ = drawn(3)
    lengths = [m for m in stated if m.kind in (HEIGHT, PEOPLE)]
    start = np.array([0.0, 0.3, 1.0, 2.0])
    fit = fitted(lengths, np.ones(2, bool), cameras, prior, start, np.arange(4) < 1)
    np.testing.assert_array_equal(fit.frame[1:], start[1:])
    assert fit.frame[0] != 0
    assert not fit.covariance[-3:].any()
