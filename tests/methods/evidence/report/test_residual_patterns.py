"""Patterns added to residuals are found, and noise has none."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.methods.evidence._solve import solve
from catfree.methods.evidence.report._residual_patterns import (
    _GROUPS,
    LEAST_TOGETHER,
    Explained,
    Patterns,
    explained,
    residual_patterns,
    seen_together,
)
from catfree.synthetic import make_world

ROWS, BLOCK = 600, 12


def drawn(seed):
    """Draw columns of patterns, and correlated noise of unit variance."""
    rng = np.random.default_rng(seed)
    block = np.arange(ROWS) // BLOCK
    columns = rng.standard_normal((ROWS, 3, 6))
    columns[..., :3] = np.eye(3)
    shared = rng.standard_normal((ROWS // BLOCK, 3))[block]
    noise = np.sqrt(0.5) * (rng.standard_normal((ROWS, 3)) + shared)
    return columns, block, noise


@given(st.integers(0, 2**32 - 1))
def test_noise_and_constant_offsets_have_no_pattern(seed):
    columns, block, noise = drawn(seed)
    found = explained(noise + np.array([1.0, -0.5, 0.3]), columns, block)
    assert (found.share < 0.03).all()


@given(st.integers(0, 2**32 - 1), st.integers(0, 1))
def test_a_planted_pattern_is_found_with_its_share(seed, kind):
    columns, block, noise = drawn(seed)
    at = _GROUPS[kind].start
    found = explained(noise + 0.6 * columns[..., at], columns, block)
    np.testing.assert_allclose(found.coefficient[at - 3], 0.6, atol=0.15)
    np.testing.assert_allclose(found.share[kind], 0.36 / 1.36, atol=0.08)
    assert (np.delete(found.share, kind) < 0.03).all()


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_the_errors_of_as_few_people_as_coefficients_have_no_pattern(seed, people):
    columns, block, noise = drawn(seed)
    few = block < people
    assert (explained(noise[few], columns[few], block[few]).share <= 0).all()
    apart = 9 * block[few]  # other cameras see the people in between
    assert (explained(noise[few], columns[few], apart).share <= 0).all()


def test_one_instant_has_no_halves():
    world = make_world("ring5", 3, frames=1, people=8)  # with a disturbed rig
    found = residual_patterns(solve(world.detections, world.scene))
    assert found.largest_shift == 0
    assert found.sentences() == ()


@pytest.mark.parametrize("delay", [1, 2])
def test_a_late_camera_displaces_people_by_a_part_of_what_they_walk_meanwhile(delay):
    """Positions follow the late camera in part, so that it is off by less from them."""
    world = make_world("ring5", 3, frames=60, people=8)
    boxes = world.detections
    late = boxes.frame + delay * (boxes.camera == 1)
    state = solve(dataclasses.replace(boxes, frame=late), world.true_scene)
    found = residual_patterns(state)
    speed = np.linalg.norm(state.trails.mean[state.shown, 3:], axis=1)
    walked = np.median(speed[speed >= np.median(speed)])
    assert found.largest_shift == found.shift[1, 0]
    assert 1 / 3 < found.largest_shift / (delay * walked) < 1


def test_a_turned_camera_displaces_people_by_a_part_of_half_of_its_turn():
    world = make_world("ring5", 3, frames=60, people=8)
    boxes, turned = world.detections, 24.0  # pixels
    moved = turned * ((boxes.camera == 1) & (boxes.frame >= 30))
    box = boxes.box + moved[:, None] * np.array([1, 0, 1, 0])
    found = residual_patterns(solve(dataclasses.replace(boxes, box=box), world.true_scene))
    height = np.median((boxes.box[:, 3] - boxes.box[:, 1])[boxes.camera == 1])  # of about H0
    assert found.largest_shift == found.shift[1, 1]
    assert 1 / 3 < found.largest_shift / (turned / 2 / height) < 1


@pytest.mark.parametrize("rows", [0, 5])
def test_without_residuals_there_is_no_pattern(rows):
    found = explained(np.zeros((rows, 3)), np.zeros((rows, 3, 6)), np.zeros(rows, int))
    assert (found.share == 0).all()
    assert (found.coefficient == 0).all()


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
def test_cameras_that_miss_people_on_their_own_see_them_together_as_often_as_expected(seed, count):
    rng = np.random.default_rng(seed)
    rate = rng.uniform(0.5, 0.95, (2000, count))
    found = seen_together(rng.random(rate.shape) < rate, rate)
    apart = ~np.eye(count, dtype=bool)
    np.testing.assert_allclose(found[apart], 1, atol=0.15)
    assert np.isnan(np.diag(found)).all()


def test_two_groups_of_cameras_that_see_other_people_are_told():
    """Everyone is found twice: by the first two cameras, and by the last two at another time."""
    seen = np.repeat([[True, True, False, False], [False, False, True, True]], 100, axis=0)
    found = seen_together(seen, np.full(seen.shape, 0.5))
    assert (found[:2, 2:] < LEAST_TOGETHER).all()
    assert found[0, 1] > 1
    assert found[2, 3] > 1


def test_few_expected_sightings_say_nothing():
    assert np.isnan(seen_together(np.zeros((5, 3), bool), np.full((5, 3), 0.9))).all()


def test_sentences_name_cameras_by_name_or_number():
    together = np.full((3, 3), np.nan)
    together[0, 1] = together[1, 0] = 0.0
    share, coefficient = np.zeros((3, 2)), np.zeros((3, 3))
    share[2], coefficient[2] = 0.9, (-2.0, 3.0, 4.0)
    patterns = Patterns(Explained(share, coefficient), np.zeros((3, 2)), together)
    for names, (first, second, third) in (
        (None, "012"),
        (["a", "b 0", "7"], ("'a'", "'b 0'", "'7'")),
    ):
        late, moved, apart = patterns.sentences(names)
        assert late.startswith(f"The boxes of camera {third} are behind the people by 2.0 frames")
        assert moved.startswith(f"Camera {third} shows people 10 pixels apart")
        assert apart.startswith(f"Cameras {first} and {second} hardly ever see the same person")
