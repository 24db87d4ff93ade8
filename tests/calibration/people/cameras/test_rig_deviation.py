"""The uncertainty of shape and metric scale of a rig from people."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.calibration.people.cameras._rig_deviation import (
    crowd_deviation,
    scale_deviation,
    shape_deviation,
)
from catfree.geometry import fit_similarity
from catfree.settings import CalibrationSettings

RULES = CalibrationSettings()


def rig(seed: int, cameras: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(cameras, 7)) * 5


@given(seed=st.integers(0, 1000), cameras=st.integers(2, 8), sd=st.floats(0, 0.3))
@settings(deadline=None, max_examples=25)
def test_a_rig_that_swells_by_some_percent_is_that_uncertain(
    seed: int, cameras: int, sd: float
) -> None:
    parameters = rig(seed, cameras)
    direction = np.zeros((cameras, 7))
    direction[:, 4:] = parameters[:, 4:] - parameters[0, 4:]  # swells about its first camera
    covariance = sd**2 * np.einsum("ci,dj->cidj", direction, direction)
    found = scale_deviation(parameters, covariance, np.ones(cameras, bool))
    assert found == pytest.approx(sd, abs=1e-9)


@jax.jit
def fitted_to(centers: jax.Array, moved: jax.Array) -> jax.Array:
    """Align each of the moved rigs with the centers by a similarity."""
    return jax.vmap(lambda points: fit_similarity(points, centers)(points))(moved)


@pytest.mark.slow
@given(seed=st.integers(0, 1000), cameras=st.integers(3, 6), scale=st.floats(1e-3, 1e3))
@settings(deadline=None, max_examples=15)
def test_the_deviation_of_the_shape_is_what_a_similarity_leaves(
    seed: int, cameras: int, scale: float
) -> None:
    """Compare with similarities fitted to many drawn rigs; the unit is that of the centers."""
    rng = np.random.default_rng(seed)
    parameters = rig(seed, cameras + 1)
    known = np.arange(cameras + 1) > 0
    half = rng.normal(size=(7 * (cameras + 1), 7)) * 1e-3
    covariance = (half @ half.T).reshape(cameras + 1, 7, cameras + 1, 7)
    found = shape_deviation(parameters, covariance, known)
    centers = parameters[known, 4:]
    draws = rng.normal(size=(400, 7)) @ half.T
    moved = (parameters + draws.reshape(400, -1, 7))[:, known, 4:]
    fitted = fitted_to(centers, moved)
    left = ((np.asarray(fitted) - centers) ** 2).sum(-1).mean(-1)
    assert found == pytest.approx(np.sqrt(np.mean(left)), rel=0.25)
    larger = shape_deviation(parameters * scale, covariance * scale**2, known)
    assert larger == pytest.approx(scale * found, rel=1e-6)


def test_a_rig_that_moves_as_a_whole_has_a_sure_shape() -> None:
    parameters, known = rig(1, 5), np.ones(5, bool)
    moves = np.zeros((5, 7, 7))
    moves[:, 4:, :3] = np.eye(3)
    moves[:, 4:, 3:6] = np.cross(np.eye(3)[None], parameters[:, None, 4:]).swapaxes(1, 2)
    moves[:, 4:, 6] = parameters[:, 4:]
    covariance = np.einsum("cik,djk->cidj", moves, moves)
    assert shape_deviation(parameters, covariance, known) == pytest.approx(0, abs=1e-5)
    covariance[2, 4] = np.nan
    assert shape_deviation(parameters, covariance, known) is None
    known[2] = False
    assert shape_deviation(parameters, covariance, known) is not None
    known[:2] = False
    assert shape_deviation(parameters, covariance, known) is None


@given(seed=st.integers(0, 1000), people=st.floats(1, 50))
@settings(deadline=None, max_examples=25)
def test_more_people_and_surer_cameras_never_make_the_scale_less_sure(
    seed: int, people: float
) -> None:
    parameters, known = rig(seed, 4), np.array([True, True, False, True])
    half = np.random.default_rng(seed).normal(size=(28, 28)) * 0.05
    covariance = (half @ half.T).reshape(4, 7, 4, 7)
    found = scale_deviation(parameters, covariance, known)
    assert scale_deviation(parameters, covariance / 2, known) <= found
    crowd = crowd_deviation(people, RULES)
    assert crowd_deviation(2 * people, RULES) <= crowd
    # No number of frames reveals how tall the crowd is.
    assert crowd >= np.hypot(RULES.crowd_height_sd, RULES.box_slack_sd * RULES.person_height)


def test_cameras_that_are_not_known_say_nothing() -> None:
    parameters, known = rig(0, 3), np.array([True, False, True])
    parameters[1] = np.nan
    covariance = (np.eye(21) * 0.01).reshape(3, 7, 3, 7)
    found = scale_deviation(parameters, covariance, known)
    parameters[1] = 100.0
    assert scale_deviation(parameters, covariance, known) == found
    assert np.isfinite(found)


def test_boxes_show_people_taller_than_they_are() -> None:
    rules = replace(RULES, person_height=1.6, box_slack=0.05)
    assert rules.apparent_height == pytest.approx(1.68)
