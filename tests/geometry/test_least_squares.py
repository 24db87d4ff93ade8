"""The Schur solver: the steps and the minimum of dense solvers, on drawn bundle adjustments."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import least_squares

from catfree.geometry._least_squares import (
    NormalEquations,
    Residuals,
    SchurLevenbergMarquardt,
    Unknowns,
    cauchy,
    huber,
    minimize,
    robust,
)

VIEWS, BLOCKS = 3, 6
LOSSES = {
    "linear": lambda s: s,
    "cauchy": partial(cauchy, width=2.0),
    "huber": partial(huber, width=1.3),
}
seeds = st.integers(0, 10**6)
losses = pytest.mark.parametrize("loss", list(LOSSES))


def residuals(unknowns, args):
    """Define nonlinear sightings of 2-vectors and priors on everything, some between views."""
    uncertain, (measured, weight, start) = args

    def sighting(view, block):
        turned = jnp.sin(view[0]) * block + view[1:] + 0.03 * block[::-1] ** 2
        return turned + uncertain.sum() * jnp.cos(block)

    found = jax.vmap(jax.vmap(sighting, (None, 0)), (0, None))(unknowns.view, unknowns.block)
    view, block = unknowns.view, unknowns.block
    between = view[:, 0] - view[:, 0].mean()
    return Residuals(
        ((measured - found) * weight[..., None])[:, :, None],
        jnp.concatenate([3 * (view - start.view).reshape(-1), 2 * between]),
        jnp.stack([(block - start.block).sum(1), jnp.sin(block[:, 0])], 1),
    )


def problem(unknowns, args, loss):
    return robust(residuals(unknowns, args), LOSSES[loss])


def edge_problem(unknowns, args):
    """Apply the loss to each component of a sighting instead of its length."""
    whole = residuals(unknowns, args)
    return robust(whole._replace(sighting=whole.sighting.swapaxes(2, 3)), LOSSES["cauchy"])


PROBLEMS = {loss: partial(problem, loss=loss) for loss in LOSSES} | {"edges": edge_problem}


def drawn(seed, blocks=BLOCKS, noise=0.05):
    """Draw a start and a problem's arguments, with some sightings absent and some wrong."""
    rng = np.random.default_rng(seed)
    truth = Unknowns(rng.normal(0.8, 0.1, (VIEWS, 3)), rng.normal(0, 1, (blocks, 2)))
    start = jax.tree.map(lambda a: a + 0.05 * rng.standard_normal(a.shape), truth)
    weight = rng.uniform(3, 9, (VIEWS, blocks)) * (rng.random((VIEWS, blocks)) < 0.8)
    nothing = np.zeros((VIEWS, blocks, 2))
    seen, _, _ = residuals(truth, (np.zeros(0), (nothing, np.ones_like(weight), start)))
    measured = -np.asarray(seen)[:, :, 0] + noise * rng.standard_normal(nothing.shape)
    measured += 0.6 * (rng.random((VIEWS, blocks, 1)) < 0.1)
    start, data = jax.tree.map(jnp.asarray, (start, (measured, weight, start)))
    return start, (jnp.zeros(0), data)


def flat(unknowns):
    return np.concatenate([np.asarray(leaf).ravel() for leaf in unknowns])


def unflat(values):
    views, blocks = values[: 3 * VIEWS], values[3 * VIEWS :]
    return Unknowns(views.reshape(VIEWS, 3), blocks.reshape(-1, 2))


traces = []


@partial(jax.jit, static_argnames="loss")
def solve(start, args, loss, most_steps=200):
    traces.append(loss)
    solver = SchurLevenbergMarquardt(rtol=0.0, atol=1e-14, most_steps=most_steps)
    return minimize(PROBLEMS[loss], start, args, solver)


@partial(jax.jit, static_argnames="loss")
def linearized(start, args, loss):
    return NormalEquations.of(PROBLEMS[loss], start, args)


@jax.jit
def step_of(equations, damping):
    return equations.damped(damping).solve(3 * VIEWS)


@partial(jax.jit, static_argnames="loss")
def dense_jacobian(start, args, loss):
    """Return (R, n) derivatives of all reweighted residuals, and the residuals (R,)."""

    def stacked(values):
        aux = PROBLEMS[loss](unflat(values), args)[1]
        return jnp.concatenate([leaf.ravel() for leaf in aux])

    values = jnp.concatenate([leaf.ravel() for leaf in start])
    return jax.jacfwd(stacked)(values), stacked(values)


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@pytest.mark.slow
@losses
@settings(max_examples=8)
@given(seed=seeds)
def test_a_step_is_that_of_the_dense_normal_equations(loss, seed):
    start, args = drawn(seed)
    J, r = (np.asarray(a) for a in dense_jacobian(start, args, loss))
    matrix = J.T @ J
    matrix[np.diag_indices_from(matrix)] *= 1 + 0.01
    view, block = step_of(linearized(start, args, loss)[0], 0.01)
    np.testing.assert_allclose(
        flat((view, block)), np.linalg.solve(matrix, -J.T @ r), rtol=1e-6, atol=1e-9
    )


@pytest.mark.slow
@losses
@settings(max_examples=8)
@given(seed=seeds)
def test_derivatives_are_those_of_finite_differences(loss, seed):
    start, args = drawn(seed)
    equations, _ = linearized(start, args, loss)

    def cost(values):
        out, _ = PROBLEMS[loss](unflat(values), args)
        return float(sum(jnp.sum(leaf**2) for leaf in out))

    direction = np.random.default_rng(seed).standard_normal(flat(start).size)
    gradient = -2 * flat((equations.common_right, equations.block_right[:, 0].T))
    here, step = flat(start), 1e-6 * direction
    numeric = (cost(here + step) - cost(here - step)) / 2e-6
    assert gradient @ direction == pytest.approx(numeric, rel=1e-5, abs=1e-5)


@pytest.mark.slow
@losses
@settings(max_examples=5)
@given(seed=seeds)
def test_the_minimum_is_that_of_optimistix(loss, seed):
    start, args = drawn(seed)
    found = solve(start, args, loss)
    dense = optx.least_squares(
        PROBLEMS[loss],
        optx.LevenbergMarquardt(1e-10, 1e-10),
        found.value,
        args,
        has_aux=True,
        throw=False,
    )
    np.testing.assert_allclose(flat(found.value), flat(dense.value), atol=1e-5)


@pytest.mark.slow
@settings(max_examples=5)
@given(seed=seeds)
def test_the_minimum_is_that_of_scipy(seed):
    start, args = drawn(seed)
    found = solve(start, args, "edges")
    sightings = 2 * VIEWS * BLOCKS

    def loss(z):
        far = np.arange(z.size) < sightings  # priors are quadratic
        values = np.log1p(z), 1 / (1 + z), -1 / (1 + z) ** 2
        return np.array([np.where(far, v, w) for v, w in zip(values, (z, 1, 0), strict=True)])

    peer = least_squares(
        lambda values: np.asarray(dense_jacobian(unflat(values), args, "linear")[1]),
        flat(start),
        jac=lambda values: np.asarray(dense_jacobian(unflat(values), args, "linear")[0]),
        loss=loss,
        f_scale=2.0,
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-10,
    )
    assert float(found.stats["cost"]) == pytest.approx(2 * peer.cost, rel=1e-6)
    np.testing.assert_allclose(flat(found.value), peer.x, atol=1e-3)


@pytest.mark.slow
def test_other_data_and_numbers_of_steps_need_no_compilation():
    solve(*drawn(0), "linear", 3)
    before = len(traces)
    for seed in range(3):
        solve(*drawn(seed), "linear", 5 + seed)
    assert len(traces) == before


@pytest.mark.slow
@losses
def test_every_step_lowers_the_robust_cost(loss):
    start, args = drawn(1)
    costs = [float(solve(start, args, loss, most_steps=n).stats["cost"]) for n in range(4)]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0]
    out, _ = PROBLEMS[loss](solve(start, args, loss, most_steps=3).value, args)
    assert costs[-1] == pytest.approx(float(sum(jnp.sum(leaf**2) for leaf in out)))


@pytest.mark.parametrize("loss", ["cauchy", "huber"])
@given(length=st.floats(0, 100), width=st.floats(0.5, 5))
def test_losses_are_those_of_scipy(loss, length, width):
    found = float({"cauchy": cauchy, "huber": huber}[loss](jnp.asarray(length**2), width))
    z = (length / width) ** 2
    expected = np.log1p(z) if loss == "cauchy" else (z if z <= 1 else 2 * np.sqrt(z) - 1)
    assert found == pytest.approx(width**2 * expected, rel=1e-9, abs=1e-12)


@pytest.mark.slow
@settings(max_examples=8)
@given(seeds)
def test_absent_sightings_and_whole_absent_blocks_change_nothing(seed):
    start, (uncertain, (measured, weight, tie)) = drawn(seed)
    pad = ((0, 0), (0, 4))  # four blocks more
    wide = jnp.pad(measured, (*pad, (0, 0)), constant_values=7.0), jnp.pad(weight, pad)
    more = lambda u: u._replace(block=jnp.pad(u.block, ((0, 4), (0, 0))))  # noqa: E731
    small, _ = linearized(start, (uncertain, (measured, weight, tie)), "cauchy")
    large, _ = linearized(more(start), (uncertain, (*wide, more(tie))), "cauchy")
    views, blocks = step_of(small, 0.1)
    others, padded = step_of(large, 0.1)
    np.testing.assert_allclose(views, others, rtol=1e-9)
    np.testing.assert_allclose(blocks, padded[:BLOCKS], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(padded[BLOCKS:], 0, atol=1e-12)


@pytest.mark.slow
@settings(max_examples=5)
@given(seeds, st.floats(0.01, 1))
def test_the_covariance_is_that_of_the_dense_problem_and_considers_what_is_held(seed, sd):
    start, (_, data) = drawn(seed)
    uncertain = jnp.array([0.1, -0.05])
    spread = np.diag([sd**2, 0.04])
    equations, _ = linearized(start, (uncertain, data), "huber")

    def stacked(values):
        unknowns, held = unflat(values[:-2]), values[-2:]
        return jnp.concatenate([a.ravel() for a in PROBLEMS["huber"](unknowns, (held, data))[1]])

    J = np.asarray(jax.jit(jax.jacfwd(stacked))(jnp.concatenate([flat(start), uncertain])))
    inverse = np.linalg.inv(J[:, :-2].T @ J[:, :-2])
    response = -inverse @ J[:, :-2].T @ J[:, -2:]
    expected = inverse + response @ spread @ response.T
    found = np.asarray(jax.jit(NormalEquations.covariance)(equations, jnp.asarray(spread)))
    size = 3 * VIEWS
    scale = np.sqrt(np.diag(expected))[:size, None]
    wanted = expected[:size, :size] / scale / scale.T
    np.testing.assert_allclose(found[:size, :size] / scale / scale.T, wanted, atol=1e-5)
    wanted = response[:size] @ spread / scale
    np.testing.assert_allclose(found[:size, size:] / scale, wanted, atol=1e-5)
    np.testing.assert_allclose(found[size:, size:], spread)


@pytest.mark.slow
def test_views_alone_need_no_blocks():
    start, (uncertain, data) = drawn(3)

    def views_only(unknowns, args):
        full = residuals(Unknowns(unknowns.view, start.block), args)
        return robust(full._replace(block=jnp.zeros((BLOCKS, 0))), LOSSES["cauchy"])

    at = Unknowns(start.view, jnp.zeros((BLOCKS, 0)))
    solver = SchurLevenbergMarquardt(0.0, 1e-14)
    found = minimize(views_only, at, (uncertain, data), solver)
    dense = optx.least_squares(
        views_only,
        optx.LevenbergMarquardt(1e-10, 1e-10),
        found.value,
        (uncertain, data),
        has_aux=True,
    )
    np.testing.assert_allclose(found.value.view, dense.value.view, atol=1e-6)


@pytest.mark.slow
def test_a_start_without_a_finite_cost_stays():
    start, (uncertain, (measured, weight, tie)) = drawn(2)
    found = solve(start, (uncertain, (measured * jnp.inf, weight, tie)), "cauchy")
    np.testing.assert_array_equal(flat(found.value), flat(start))
