"""The auxiliary score against its definition in NumPy, and the signals against geometry."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree.filters as filters
from catfree.errors import InvalidInputError
from catfree.filters import Signal

score_of = jax.jit(filters.auxiliary_score)


def signals_of(seed, count=60):
    """Draw signals of good and bad hypotheses, which all columns separate, with noise."""
    random = np.random.default_rng(seed)
    good = random.random(count) < 0.6
    strength = np.array([3, 1, 2, 0.5, 1, 2, 1])
    signals = random.normal(size=(count, 7)) + good[:, None] * strength
    return signals * np.array([1, 0.01, 0.2, 0.3, 1, 5, 100]), good


def score_by_hand(signals):
    standardized = (signals - signals.mean(0)) / signals.std(0)
    weights = np.zeros(7)
    for j in range(7):
        ordered = np.sort(signals[:, j])
        weights[j] = max(
            k
            * (len(ordered) - k)
            * (ordered[k:].mean() - ordered[:k].mean()) ** 2
            / len(ordered) ** 2
            for k in range(1, len(ordered))
        ) / np.var(ordered)
    consensus = standardized[:, :6] @ weights[:6]
    weights[6] *= max(0, np.corrcoef(standardized[:, 6], consensus)[0, 1])
    return standardized @ weights / weights.sum(), weights


@pytest.mark.slow
@given(seed=st.integers(0, 1000), flip=st.booleans())
def test_score_equals_its_definition(x64, seed, flip):
    signals, _ = signals_of(seed)
    if flip:
        signals[:, Signal.RECONSTRUCTION_CONFIDENCE] *= -1  # disagrees with the others
    score, weights = score_by_hand(signals)
    result = score_of(signals)
    np.testing.assert_allclose(result.score, score, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(result.weights, weights, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(result.threshold, filters.otsu(result.score))
    assert (result.weights[Signal.RECONSTRUCTION_CONFIDENCE] > 0) == (not flip)


@pytest.mark.parametrize("unit", [1e-25, 1e25])
def test_the_smallest_and_largest_units_do_not_matter(dtype, unit):
    signals, _ = signals_of(0)
    plain, moved = (score_of((signals * factor).astype(dtype)) for factor in (1, unit))
    np.testing.assert_allclose(moved.score, plain.score, atol=1e-5)
    heights = np.array([1.6, 2.0, 0.0]) * unit
    where = np.array([True, True, False])
    consistency = filters.height_consistency(heights.astype(dtype), where)
    np.testing.assert_allclose(consistency, -0.2 / 1.8, rtol=1e-6)


@pytest.mark.slow
@given(seed=st.integers(0, 1000), data=st.data())
def test_units_and_order_do_not_matter(x64, seed, data):
    signals, _ = signals_of(seed, 20)
    order = np.array(data.draw(st.permutations(range(20))))
    factor = np.array(data.draw(st.tuples(*[st.floats(1e-3, 1e3)] * 7)))
    shift = np.array(data.draw(st.tuples(*[st.floats(-10, 10)] * 7)))
    plain = score_of(signals)
    moved = score_of(signals[order] * factor + shift * factor)
    np.testing.assert_allclose(moved.score, plain.score[order], atol=1e-9)
    np.testing.assert_allclose(moved.weights, plain.weights, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_the_score_ranks_better_than_any_signal(seed):
    signals, good = signals_of(seed)

    def share_of_pairs_in_order(values):
        return (values[good][:, None] > values[~good]).mean()

    best_signal = max(share_of_pairs_in_order(column) for column in signals.T)
    assert share_of_pairs_in_order(np.asarray(score_of(signals).score)) >= best_signal


@pytest.mark.slow
def test_masked_out_is_left_out(dtype):
    signals, _ = signals_of(1, 20)
    signals = signals.astype(dtype)
    alone = score_of(signals)
    padded = np.concatenate([signals, np.full((5, 7), np.nan, dtype)])
    padded[-1] = 1e9
    result = score_of(padded, np.arange(25) < 20)
    np.testing.assert_allclose(result.score[:20], alone.score, atol=20 * np.finfo(dtype).eps)
    np.testing.assert_allclose(result.weights, alone.weights, rtol=20 * np.finfo(dtype).eps)
    np.testing.assert_allclose(result.threshold, alone.threshold, atol=20 * np.finfo(dtype).eps)
    np.testing.assert_array_equal(result.score[20:], 0)
    assert result.score.dtype == result.weights.dtype == result.threshold.dtype == dtype


@pytest.mark.slow
@pytest.mark.parametrize("column", [Signal.DETECTOR_CONFIDENCE, Signal.RECONSTRUCTION_CONFIDENCE])
def test_a_missing_signal_has_no_say(column):
    signals, _ = signals_of(2)
    constant, missing = signals.copy(), signals.copy()
    constant[:, column], missing[:, column] = 0.3, np.nan
    result = score_of(missing)
    assert result.weights[column] == 0
    assert np.isfinite(result.score).all()
    np.testing.assert_allclose(score_of(constant).score, result.score, atol=1e-6)


@pytest.mark.slow
def test_a_missing_entry_counts_as_average():
    signals, _ = signals_of(3)
    signals = signals.astype(np.float32)
    signals[0, 2] = np.nan
    filled = signals.copy()
    result = score_of(signals)
    known = signals[1:, 2]
    filled[:, 2] = (np.where(np.isnan(signals[:, 2]), known.mean(), signals[:, 2])) - known.mean()
    expected = filled[:, 2] / known.std()
    others = np.delete(np.arange(7), 2)
    rest = (signals[:, others] - signals[:, others].mean(0)) / signals[:, others].std(0)
    weights = np.asarray(result.weights)
    by_hand = (rest @ weights[others] + expected * weights[2]) / weights.sum()
    np.testing.assert_allclose(result.score, by_hand, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_hypotheses(dtype, count):
    result = score_of(np.arange(count * 7).reshape(count, 7).astype(dtype))
    assert result.score.shape == (count,)
    assert np.isfinite(result.score).all()
    assert np.isfinite(result.weights).all()


def test_view_support_ratio_by_hand():
    supporting = np.array([True, True, False, False])
    seeing = np.array([True, False, True, False])
    # Three cameras see the position, one of them as its support shows.
    np.testing.assert_allclose(filters.view_support_ratio(supporting, seeing), 2 / 3, rtol=1e-6)
    assert filters.view_support_ratio(np.zeros(2, bool), np.zeros(2, bool)) == 0


def test_median_residual_by_hand(dtype):
    residuals = np.array([0.3, np.nan, 0.1, 9.0], dtype)
    mask = np.array([True, False, True, False])
    np.testing.assert_allclose(filters.median_residual(residuals, mask), 0.2, rtol=1e-6)
    assert np.isnan(filters.median_residual(residuals, np.zeros(4, bool)))
    nobody = filters.median_residual(residuals[:0], mask[:0])
    assert np.isnan(nobody)
    assert nobody.dtype == dtype


@pytest.mark.slow
def test_height_consistency_by_hand(dtype):
    heights = np.array([1.6, 2.0, np.nan], dtype)
    where = np.array([True, True, False])
    np.testing.assert_allclose(filters.height_consistency(heights, where), -0.2 / 1.8, rtol=1e-6)
    assert filters.height_consistency(np.array([2, 2, 2], dtype), where) == 0
    assert np.isnan(filters.height_consistency(heights, np.array([True, False, False])))
    assert np.isnan(filters.height_consistency(np.zeros(3, dtype), where))


@st.composite
def views(draw):
    """Draw a camera above a ground of any attitude, looking at a standing person."""
    random = np.random.default_rng(draw(st.integers(0, 10_000)))
    world, _ = np.linalg.qr(random.normal(size=(3, 3)))
    normal = world[:, 2]
    foot = world @ [*random.normal(size=2), 0]
    centre = foot + world @ [draw(st.floats(3, 30)), draw(st.floats(-2, 2)), draw(st.floats(1, 8))]
    towards = foot + normal - centre
    z = towards / np.linalg.norm(towards)
    x = np.cross(z, normal)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    offset = draw(st.floats(-3, 3))
    origin = -offset * normal  # lies on the ground n·x + offset = 0
    K = np.array([[900, 3, 640], [0, 880, 360], [0, 0, 1.0]])
    return K, R, -R @ (centre + origin), foot + origin, normal, offset


def project(K, R, t, point):
    pixel = K @ (R @ point + t)
    return pixel[:2] / pixel[2]


def ray_of(K, R, u, v):
    ray = R.T @ np.linalg.solve(K, [u, v, 1])
    return ray / np.linalg.norm(ray)


@pytest.mark.slow
@given(view=views(), height=st.floats(0.3, 2.5), lift=st.floats(-0.5, 0.5))
def test_implied_height_is_the_height_of_what_is_projected(x64, view, height, lift):
    K, R, t, foot, normal, offset = view
    u, v = project(K, R, t, foot + height * normal)
    position = foot + lift * normal  # only the place on the ground counts
    ray = ray_of(K, R, u, v)
    measured = filters.implied_height(-R.T @ t, ray, position, normal, np.asarray(offset))
    np.testing.assert_allclose(measured, height, atol=1e-9)


@pytest.mark.slow
@given(view=views(), shift=st.floats(-60, 60), factor=st.sampled_from([0.001, 3.0, 1000.0]))
def test_implied_height_is_the_nearest_approach_and_follows_scale(x64, view, shift, factor):
    K, R, t, foot, normal, offset = view
    u, v = project(K, R, t, foot + 1.7 * normal)
    direction = ray_of(K, R, u + shift, v)
    # Nearest points of two lines by linear least squares.
    lines = np.stack([direction, -normal], -1)
    centre = -R.T @ t
    _, along = np.linalg.lstsq(lines, foot - centre)[0]
    measured = filters.implied_height(centre, direction, foot, normal, np.asarray(offset))
    np.testing.assert_allclose(measured, along, atol=1e-8)
    scaled = filters.implied_height(
        centre * factor, direction, foot * factor, normal, np.asarray(offset * factor)
    )
    np.testing.assert_allclose(scaled, measured * factor, rtol=1e-8, atol=1e-8 * factor)


@pytest.mark.slow
@pytest.mark.parametrize("foot", [[0, 0, 0], [0, 0, 5], [4, 0, 0]])
def test_implied_height_is_finite_for_a_camera_looking_down(dtype, foot):
    camera = (np.array([0, 0, 5], dtype), np.array([0, 0, -1], dtype))  # 5 above the origin
    ground = (np.array([0, 0, 1], dtype), np.array(0, dtype))
    foot = np.array(foot, dtype)
    assert filters.implied_height(*camera, foot, *ground) == 5
    height, gradient = jax.value_and_grad(filters.implied_height, 2)(
        *map(jnp.asarray, (*camera, foot, *ground))
    )
    assert np.isfinite(gradient).all()
    assert height.dtype == dtype


@pytest.mark.parametrize("signal", [filters.median_residual, filters.height_consistency])
def test_a_mask_of_another_length_is_an_error(signal):
    with pytest.raises(InvalidInputError, match=r"where must have shape \(3\), got \(1,\)"):
        inspect.unwrap(signal)(np.ones(3), np.ones(1, bool))


def test_a_column_too_few_is_an_error_not_another_signal():
    unchecked = inspect.unwrap(filters.auxiliary_score)  # as without type checks
    with pytest.raises(InvalidInputError, match="one column for each"):
        unchecked(np.zeros((4, 6)))


def test_masks_of_cameras_hold_true_and_false_of_one_shape():
    ratio = inspect.unwrap(filters.view_support_ratio)  # bypass the tests' type checks
    assert ratio(np.array([1, 0, 1]), np.ones(3)) == np.float32(2 / 3)
    with pytest.raises(InvalidInputError, match=r"supporting\[0\] is neither true nor false"):
        ratio(np.array([2, 0, 3]), np.array([1, 1, 1]))
    with pytest.raises(InvalidInputError, match="seeing must have shape"):
        ratio(np.ones(3, bool), np.ones(1, bool))
