"""A camera in seven numbers: the direction of each, and what no picture can tell.

The conversion to matrices is in `test_people_geometry`.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration.people.cameras._camera_model import (
    PAN,
    X,
    Z,
    from_matrices,
    projection,
    rotation,
    to_matrices,
)
from catfree.geometry._person import NEAREST_DEPTH, box_edges, box_ends
from tests.calibration.people.boxes_of_rows import boxes_of_rows

LEVEL = np.array([7.0, 0, 0, 0, 0, 0, 3.0])

seeds = st.integers(0, 10**6)


def drawn(seed, count=8):
    """Draw cameras (n, 7) and one person in front of each: xy (n, 2) and height (n,)."""
    rng = np.random.default_rng(seed)
    low = np.array([6.5, 0.05, -0.3, -3.1, -5, -5, 2])
    high = np.array([7.6, 0.7, 0.3, 3.1, 5, 5, 6])
    camera = rng.uniform(low, high, (count, 7))
    ahead = np.stack([-np.sin(camera[:, PAN]), np.cos(camera[:, PAN])], -1)
    xy = camera[:, X:Z] + rng.uniform(6, 15, (count, 1)) * ahead + rng.uniform(-2, 2, (count, 2))
    return camera, xy, rng.uniform(1.5, 1.95, count)


def changed(**fields):
    camera = LEVEL.copy()
    for name, value in fields.items():
        camera[["focal", "tilt", "roll", "pan"].index(name)] = value
    return camera


def test_angles_turn_as_they_are_said_to():
    def pixel(camera, point):
        column, row, depth = projection(camera) @ np.append(point, 1)
        return np.array([column, row]) / depth

    ahead, beside, above = (np.array([x, 10.0, z]) for x, z in ((0, 3), (1, 3), (0, 4)))
    # Level, with heading 0: along y, x to the right, and rows grow downwards.
    np.testing.assert_allclose(rotation(LEVEL), [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(pixel(LEVEL, ahead), [0, 0], atol=1e-9)
    assert pixel(LEVEL, beside)[0] > 0
    assert pixel(LEVEL, above)[1] < 0
    # Tilted down, a point ahead rises; turned left, it moves to the right.
    assert pixel(changed(tilt=0.1), ahead)[1] == pytest.approx(-np.exp(7) * np.tan(0.1))
    assert pixel(changed(pan=0.1), ahead)[0] == pytest.approx(np.exp(7) * np.tan(0.1))
    # A rolled camera turns its picture about the center and keeps the distance from it.
    right = pixel(LEVEL, beside)
    rolled = pixel(changed(roll=0.3), beside)
    np.testing.assert_allclose(rolled, [right[0] * np.cos(0.3), -right[0] * np.sin(0.3)], atol=1e-9)


@given(seeds)
def test_rotations_are_rotations_and_depth_is_along_the_axis(seed):
    camera, xy, height = drawn(seed)
    R = rotation(camera)
    np.testing.assert_allclose(R @ R.swapaxes(1, 2), np.tile(np.eye(3), (8, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    K, R2, t = to_matrices(camera, np.tile([[1920, 1080]], (8, 1)))
    np.testing.assert_array_equal(R, R2)
    np.testing.assert_allclose(from_matrices(K, R2, t), camera, atol=1e-9)
    for c, p, h in zip(camera, xy, height, strict=True):
        depth = projection(c)[2] @ [*p, h, 1]
        assert depth == pytest.approx(rotation(c)[2] @ (np.append(p, h) - c[X:]))


@jax.jit
@jax.vmap
def predicted(camera, person, offset):
    return box_edges(projection(camera), person, camera[X:Z], offset)


@jax.jit
@jax.vmap
def derivatives(camera, person, offset):
    """Derivatives of a person's box with respect to camera, person and foot offset."""

    def box(camera, person, offset):
        return box_edges(projection(camera), person, camera[X:Z], offset)

    return jax.jacfwd(box, (0, 1, 2))(camera, person, offset)


@pytest.mark.slow
@given(seeds, st.floats(0, 0.3))
def test_what_moves_cameras_and_people_together_moves_no_box(x64, seed, offset):
    camera, xy, height = drawn(seed)
    person, offsets = np.column_stack([xy, height]), np.full(len(xy), offset)
    box = np.asarray(predicted(camera, person, offsets))
    by_camera, by_person, by_offset = map(np.asarray, derivatives(camera, person, offsets))
    size = np.abs(by_person).max()
    shift = by_camera[..., X:Z] + by_person[..., :2]
    np.testing.assert_allclose(shift, 0, atol=1e-9 * size)
    # A turn about the origin also turns headings.
    turned = lambda p: np.stack([-p[:, 1], p[:, 0]], -1)  # noqa: E731
    turn = (
        by_camera[..., PAN]
        + np.einsum("nij,nj->ni", by_camera[..., X:Z], turned(camera[:, X:Z]))
        + np.einsum("nij,nj->ni", by_person[..., :2], turned(xy))
    )
    np.testing.assert_allclose(turn, 0, atol=1e-8 * size)
    # So does scaling all lengths, including the foot offset.
    growth = (
        np.einsum("nij,nj->ni", by_camera[..., X:], camera[:, X:])
        + np.einsum("nij,nj->ni", by_person, person)
        + offset * by_offset
    )
    np.testing.assert_allclose(growth, 0, atol=1e-8 * size)
    # Pixels grow with the focal length, in proportion.
    np.testing.assert_allclose(by_camera[..., 0], box, rtol=1e-9, atol=1e-9)


@given(seeds, st.floats(0, 0.3))
def test_boxes_of_numpy_are_those_of_jax(x64, seed, offset):
    camera, xy, height = drawn(seed)
    expected = predicted(camera, np.column_stack([xy, height]), np.full(len(xy), offset))
    found = boxes_of_rows(camera, xy, height, offset)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@given(seeds)
def test_under_and_behind_a_camera_everything_is_finite(x64, seed):
    camera, xy, height = drawn(seed)
    behind = 2 * camera[:, X:Z] - xy
    for place in (camera[:, X:Z], behind, camera[:, X:Z] + [0, 1e-9]):
        person = np.column_stack([place, height])
        for part in derivatives(camera, person, np.full(len(place), 0.15)):
            assert jnp.isfinite(part).all()
        head, foot, depth = box_ends(projection(camera), person, camera[:, X:Z], 0.15)
        assert np.isfinite([head, foot]).all()
        assert (place is not behind) or not (depth > NEAREST_DEPTH).any()


def test_the_foot_stands_nearer_than_the_body():
    camera = changed(tilt=0.3)
    xy, height = np.array([[0.0, 9.0]]), np.array([1.7])
    near, there = (boxes_of_rows(camera, xy, height, offset)[0] for offset in (0.15, 0.0))
    stepped = boxes_of_rows(camera, xy - [0, 0.15], height, 0.0)[0]
    assert near[2] == pytest.approx(stepped[2])  # the lower edge as for a person 15 cm nearer
    assert near[1] == pytest.approx(there[1])  # and the upper edge unchanged
