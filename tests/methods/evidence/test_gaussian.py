import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import quad

from catfree.geometry._person import box_edges, edges_and_slopes
from catfree.methods.evidence._gaussian import (
    Information,
    determinant_and_form,
    invert_symmetric,
    log_evidence,
    mean_and_covariance,
)
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings._calibration_settings import FOOT_AHEAD
from tests.methods.evidence.evidence_worlds import make_rig, make_scene


@st.composite
def informations(draw, count=1):
    number = st.floats(-2, 2, allow_nan=False, width=32)
    out = []
    for _ in range(count):
        A = np.array(draw(st.lists(number, min_size=9, max_size=9))).reshape(3, 3)
        z = np.array(draw(st.lists(number, min_size=3, max_size=3)))
        W = np.eye(3) * draw(st.floats(0.5, 20))
        A = A + 3 * np.eye(3)
        out.append(Information(A.T @ W @ A, A.T @ W @ z, np.asarray(z @ W @ z)))
    return out


def stack(items):
    return Information(
        np.stack([i.matrix for i in items]),
        np.stack([i.vector for i in items]),
        np.array([i.constant for i in items]),
    )


def together(one, other):
    return jax.tree.map(lambda a, b: np.asarray(a + b), one, other)


@given(informations())
def test_written_out_algebra_equals_numpy(items):
    M, v = items[0].matrix + np.eye(3), items[0].vector
    det, form = determinant_and_form(M, v)
    np.testing.assert_allclose(det, np.linalg.det(M), rtol=1e-9)
    np.testing.assert_allclose(form, v @ np.linalg.solve(M, v), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(invert_symmetric(M) @ M, np.eye(3), atol=1e-8)


@pytest.mark.slow
@given(informations(2), st.floats(0.01, 1.0), st.floats(0.03, 0.2))
def test_evidence_is_the_integral_of_the_likelihoods(items, density, spread):
    """The height is integrated numerically, the plane in closed form."""
    joint = together(*items)

    def slice_at(h):
        M, b = joint.matrix, joint.vector
        A, r = M[:2, :2], b[:2] - M[:2, 2] * h
        k = M[2, 2] * h * h - 2 * b[2] * h + joint.constant
        plane = (
            2
            * np.pi
            / np.sqrt(np.linalg.det(A))
            * np.exp(-0.5 * (k - r @ np.linalg.solve(A, r) - shift))
        )
        return plane * np.exp(-0.5 * ((h - 1) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))

    state, covariance = mean_and_covariance(stack([joint]), spread)
    s, width = state[0], 12 * np.sqrt(covariance[0, 2, 2])
    shift = s @ joint.matrix @ s - 2 * joint.vector @ s + joint.constant
    value, _ = quad(slice_at, s[2] - width, s[2] + width, epsabs=0, limit=200)
    expected = np.log(density * value) - 0.5 * shift
    np.testing.assert_allclose(
        log_evidence(stack([joint]), density, spread)[0], expected, rtol=1e-5, atol=1e-5
    )


@given(informations(3))
def test_evidence_does_not_depend_on_the_order_of_the_cameras(items):
    a, b, c = items
    left = stack([together(together(a, b), c)])
    right = stack([together(c, together(b, a))])
    np.testing.assert_allclose(
        log_evidence(left, 0.1, 0.05), log_evidence(right, 0.1, 0.05), rtol=1e-9, atol=1e-9
    )


@pytest.mark.slow
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.7, 1.3), st.integers(0, 4))
def test_slopes_of_the_edges_match_finite_differences(x, y, h, camera):
    with jax.enable_x64(True):
        views = ground_views(make_scene(make_rig(roll=0.2)), 1.7)
        matrix, state = jnp.asarray(views.matrix[camera]), jnp.array([x / 1.7, y / 1.7, h])
        foot = jnp.asarray(views.station[camera]), FOOT_AHEAD
        _, slopes = edges_and_slopes(matrix, state, *foot)
        step = 1e-6
        for i in range(3):
            e = step * np.eye(3)[i]
            ends = (box_edges(matrix, state + sign * e, *foot) for sign in (1, -1))
            numeric = np.subtract(*ends) / 2e-6
            np.testing.assert_allclose(slopes[:, i], numeric, rtol=1e-4, atol=1e-3)
