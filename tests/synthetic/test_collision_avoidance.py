import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from catfree.synthetic._collision_avoidance import (
    BODY_RADIUS,
    around_obstacles,
    avoidance,
    limited,
    outside_obstacles,
)

coordinates = st.floats(-5, 5, allow_subnormal=False)
vectors = arrays(np.float64, (4, 2), elements=coordinates)


@given(points=vectors)
def test_two_people_give_way_equally_and_do_not_approach(points):
    pair = points[:2]
    push = avoidance(pair, np.array([0, 1]))
    np.testing.assert_allclose(push[0], -push[1], atol=1e-12)
    assert push[0] @ (pair[0] - pair[1]) >= 0
    companions = avoidance(pair, np.array([0, 0]))
    assert np.linalg.norm(companions[0]) <= np.linalg.norm(push[0])


@given(points=vectors, shift=arrays(np.float64, 2, elements=coordinates))
def test_giving_way_depends_on_relative_places_only(points, shift):
    group = np.arange(4)
    np.testing.assert_allclose(
        avoidance(points, group), avoidance(points + shift, group), rtol=1e-6, atol=1e-6
    )


@given(points=vectors, x=coordinates, y=coordinates, radius=st.floats(0.1, 2))
def test_nobody_is_left_inside_an_obstacle_and_others_stay(points, x, y, radius):
    moved = outside_obstacles(points, np.array([[x, y, radius]]))
    distance = np.linalg.norm(moved - [x, y], axis=-1)
    assert (distance > radius + BODY_RADIUS - 1e-9).all()
    clear = np.linalg.norm(points - [x, y], axis=-1) >= radius + BODY_RADIUS
    np.testing.assert_array_equal(moved[clear], points[clear])


@given(points=vectors, longest=st.floats(0.1, 3))
def test_limits_keep_directions(points, longest):
    short = limited(points, longest)
    assert (np.linalg.norm(short, axis=-1) <= longest * (1 + 1e-9)).all()
    cross = short[:, 0] * points[:, 1] - short[:, 1] * points[:, 0]
    np.testing.assert_allclose(cross, 0, atol=1e-9)


@pytest.mark.parametrize(
    ("obstacle", "sideways"),
    [
        ((2.0, 0.2, 0.5), -1),  # ahead and a little to the left: pass on the right
        ((2.0, -0.2, 0.5), 1),
        ((2.0, 3.0, 0.5), 0),  # beside the path
        ((-2.0, 0.0, 0.5), 0),  # behind
        ((9.0, 0.0, 0.5), 0),  # far ahead
    ],
)
def test_walkers_pass_obstacles_on_the_nearer_side(obstacle, sideways):
    turn = around_obstacles(np.array([[0.0, 0.0]]), np.array([[1.2, 0.0]]), np.array([obstacle]))
    assert np.sign(turn[0, 1]) == sideways
    assert turn[0, 0] == 0
