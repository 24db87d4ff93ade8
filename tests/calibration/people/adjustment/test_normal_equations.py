"""Normal equations without the people are the full ones, solved for everybody at once."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.calibration.people.adjustment._box_measurements import BoxMeasurements, KnownCameras
from catfree.calibration.people.adjustment._normal_equations import CAUCHY, NormalEquations, _gram
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL, ROLL, box_jacobian
from catfree.settings import CalibrationSettings

RULES = CalibrationSettings()
CAMERAS, PEOPLE = 4, 9
PRIOR = np.full(CAMERAS, 7.0)


def problem(seed, *, shared, known):
    """A small adjustment away from its minimum: the equations and a state.

    The last camera sees nobody.
    """
    rng = np.random.default_rng(seed)
    angle = np.arange(CAMERAS) * np.pi / 2
    place = np.stack([9 * np.cos(angle), 9 * np.sin(angle), np.full(CAMERAS, 4.0)], -1)
    parameters = np.column_stack(
        [np.full((CAMERAS, 3), [7.0, 0.4, 0.02]), angle + np.pi / 2, place]
    )
    there = rng.random((PEOPLE, CAMERAS)) < 0.8
    there[:, :2] = True
    there[:, 3] = False
    person, camera = np.nonzero(there)
    xy, height = rng.uniform(-3, 3, (PEOPLE, 2)), rng.normal(1.7, 0.05, PEOPLE)
    box = box_jacobian(parameters[camera], xy[person], height[person], 0.15)[0]
    sd = rng.uniform(2, 9, box.shape)
    box = box + 2 * sd * rng.standard_normal(box.shape)
    data = BoxMeasurements(person, camera, box, sd)
    prior = KnownCameras(parameters + 0.01, np.array([9.0, 99, 50, 30, 4, 4, 4]))
    equations = NormalEquations(
        data, CAMERAS, PEOPLE, PRIOR, RULES, shared, prior if known else None
    )
    moved = parameters + rng.normal(0, 0.01, parameters.shape)
    return equations, (moved, 0.14, xy + rng.normal(0, 0.05, xy.shape), height + 0.02)


def unpacked(state, change):
    """The state after a change of (cameras, offset, people) in one vector."""
    parameters, offset, xy, height = state
    size = parameters.size
    people = change[size + 1 :].reshape(-1, 3)
    return (
        parameters + change[:size].reshape(-1, 7), offset + change[size],
        xy + people[:, :2], height + people[:, 2],
    )  # fmt: skip


def full_system(equations, state):
    """The normal matrix and gradient of all unknowns, from residuals differentiated numerically.

    Written as one least-squares problem: the boxes with their robust weights, then every prior.
    """
    data, used = equations.data, equations.used
    weight = np.sqrt(equations.linearize(*state).weight)

    def residuals(change):
        parameters, offset, xy, height = unpacked(state, change)
        box = box_jacobian(parameters[data.camera], xy[data.person], height[data.person], offset)[0]
        log_focal = parameters[used, LOG_FOCAL]
        rows = [
            ((data.box - box) / data.sd * weight).ravel(),
            (height - RULES.apparent_height) / RULES.person_height_sd,
            [(offset - RULES.foot_offset) / RULES.foot_offset_sd],
            (log_focal - PRIOR[used]) / RULES.focal_log_sd,
            parameters[used, ROLL] / RULES.roll_sd,
        ]
        if equations.shared:
            rows.append((log_focal - log_focal.mean()) / RULES.shared_focal_sd)
        away = (parameters - equations.known.parameters) * np.sqrt(equations.known.precision)
        rows.append(away[used].ravel())
        return np.concatenate(rows)

    size = state[0].size + 1 + 3 * len(state[2])
    steps = 1e-6 * np.eye(size)
    J = np.stack([(residuals(d) - residuals(-d)) / 2e-6 for d in steps], -1)
    # Residuals of the boxes fall where the prediction rises: the gradient leads downhill.
    return J.T @ J, -J.T @ residuals(np.zeros(size))


variants = pytest.mark.parametrize(
    ("shared", "known"), [(False, False), (True, False), (True, True)]
)


@pytest.mark.slow
@variants
@settings(max_examples=8)
@given(seed=st.integers(0, 10**6))
def test_the_step_is_that_of_the_full_system(seed, shared, known):
    equations, state = problem(seed, shared=shared, known=known)
    linear = equations.linearize(*state)
    damping = 0.3
    found = equations.step(linear, *state, damping)
    assert found is not None
    matrix, gradient = full_system(equations, state)
    matrix[np.diag_indices_from(matrix)] *= 1 + damping
    free = np.append(equations.free, np.ones(3 * PEOPLE, bool))
    change = np.zeros(len(free))
    change[free] = np.linalg.solve(matrix[np.ix_(free, free)], gradient[free])
    for mine, expected, before in zip(found, unpacked(state, change), state, strict=True):
        # Derivatives are numeric, and a millionth is added to each person's diagonal.
        np.testing.assert_allclose(mine - before, expected - before, rtol=1e-4, atol=1e-5)
    assert found[1] == state[1]  # boxes say next to nothing about the foot offset: it is held
    np.testing.assert_array_equal(found[0][3], state[0][3])


@pytest.mark.slow
@variants
@settings(max_examples=8)
@given(seed=st.integers(0, 10**6))
def test_the_covariance_is_that_of_the_full_system_and_the_held_offset(seed, shared, known):
    equations, state = problem(seed, shared=shared, known=known)
    matrix, _ = full_system(equations, state)
    size = 7 * CAMERAS
    free = np.append(equations.free, np.ones(3 * PEOPLE, bool))
    inverse = np.zeros_like(matrix)
    inverse[np.ix_(free, free)] = np.linalg.inv(matrix[np.ix_(free, free)])
    by_offset = -inverse @ matrix[:, size]
    by_offset[size] = 1
    expected = inverse + RULES.foot_offset_sd**2 * np.outer(by_offset, by_offset)
    found = equations.covariance(equations.linearize(*state), *state)
    kept = slice(0, size + 1)
    scale = np.sqrt(np.diag(expected)[kept]) + 1e-9
    np.testing.assert_allclose(
        found / np.outer(scale, scale), expected[kept, kept] / np.outer(scale, scale), atol=1e-3
    )


@pytest.mark.slow
@variants
@settings(max_examples=8)
@given(seed=st.integers(0, 10**6))
def test_the_cost_falls_along_the_gradient_as_fast_as_it_says(seed, shared, known):
    equations, state = problem(seed, shared=shared, known=known)
    _, gradient = full_system(equations, state)
    gradient[: 7 * CAMERAS].reshape(-1, 7)[3] = 0
    step = 1e-5 * gradient / np.linalg.norm(gradient)
    costs = [equations.linearize(*unpacked(state, s)).cost for s in (step, -step)]
    # The weights are those of the robust cost, whose gradient is twice that of half the squares.
    assert (costs[1] - costs[0]) / 2 == pytest.approx(2 * step @ gradient, rel=1e-4)


@given(st.integers(0, 10**6))
def test_an_edge_at_the_robust_width_counts_half_and_no_edge_counts_more_than_once(seed):
    equations, state = problem(seed, shared=False, known=False)
    linear = equations.linearize(*state)
    np.testing.assert_allclose(linear.weight, 1 / (1 + (linear.residual / CAUCHY) ** 2))
    there = equations.data.box - linear.residual * equations.data.sd
    half = dataclasses.replace(equations.data, box=there + CAUCHY * equations.data.sd)
    again = NormalEquations(half, CAMERAS, PEOPLE, PRIOR, RULES, False, None).linearize(*state)
    np.testing.assert_allclose(again.weight, 0.5)


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.floats(-1e4, 1e4))
def test_an_edge_of_no_weight_is_absent(seed, error):
    equations, state = problem(seed, shared=False, known=False)
    silent = np.random.default_rng(seed).random(equations.data.box.shape) < 0.2
    steps = []
    for wrong in (0.0, error):
        data = dataclasses.replace(
            equations.data,
            box=equations.data.box + wrong * silent,
            sd=np.where(silent, np.inf, equations.data.sd),
        )
        again = NormalEquations(data, CAMERAS, PEOPLE, PRIOR, RULES, False, None)
        steps.append(again.step(again.linearize(*state), *state, 0.1))
    for one, other in zip(*steps, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


@pytest.mark.parametrize("length", [0, 1, 7, 2**18 // 6, 2**18 // 6 + 1, 2 * (2**18 // 6) + 5])
def test_products_in_blocks_are_products(length):
    rng = np.random.default_rng(length)
    first, second = rng.standard_normal((length, 2)), rng.standard_normal((length, 3))
    np.testing.assert_allclose(_gram(first, second), first.T @ second, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("length", [1, 7, 300, 20_000])
def test_products_of_as_many_columns_as_four_cameras_have(length):
    rng = np.random.default_rng(length)
    first, second = rng.normal(size=(length, 29)), rng.normal(size=(length, 29))
    np.testing.assert_allclose(_gram(first, second), first.T @ second, rtol=1e-10, atol=1e-9)
