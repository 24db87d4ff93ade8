"""The box of a standing person: OpenCV's projections, finite differences, and the inverse."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree.geometry._person import (
    box_edges,
    box_ends,
    cut_by_border,
    edge_deviation,
    edges_and_slopes,
    edges_of,
    height_at,
    implied_height,
    people_in_rig,
)
from catfree.geometry.camera import rays_of_pixels
from catfree.types import Lens, Rig

seeds = st.integers(0, 10**6)
predicted = jax.jit(box_edges)
derivatives = jax.jit(jax.jacfwd(box_edges, (0, 1, 2, 3)))


def drawn(seed):
    """Draw a camera (K, R, t, center) that looks at a person (3,) from some meters away."""
    rng = np.random.default_rng(seed)
    person = np.append(rng.uniform(-3, 3, 2), rng.uniform(1.4, 2.0))
    center = np.append(person[:2] + rng.uniform(4, 9) * np.array([0, -1]), rng.uniform(1, 4))
    look = Rotation.from_euler("x", -np.pi / 2 - rng.uniform(0, 0.3))
    R = (Rotation.from_euler("yz", rng.uniform(-0.3, 0.3, 2)) * look.inv()).as_matrix()
    K = np.array([[rng.uniform(500, 1500), 0, 320], [0, rng.uniform(500, 1500), 240], [0, 0, 1]])
    return K, R, -R @ center, center, person


def matrix(K, R, t):
    return K @ np.column_stack([R, t])


@given(seeds, st.floats(0, 0.4))
def test_edges_are_the_pixels_of_head_and_foot(x64, seed, offset):
    K, R, t, center, person = drawn(seed)
    toward = (center[:2] - person[:2]) / np.linalg.norm(center[:2] - person[:2])
    foot = np.append(person[:2] + offset * toward, 0.0)
    pixels, _ = cv2.projectPoints(np.stack([person, foot]), cv2.Rodrigues(R)[0], t, K, None)
    head, foot = pixels[:, 0]
    found = predicted(matrix(K, R, t), person, center[:2], offset)
    np.testing.assert_allclose(found, [(head[0] + foot[0]) / 2, head[1], foot[1]], rtol=1e-9)


@pytest.mark.slow
@given(seeds, st.floats(0, 0.4))
def test_derivatives_are_those_of_finite_differences(x64, seed, offset):
    K, R, t, center, person = drawn(seed)
    at = [matrix(K, R, t), person, center[:2], np.array(offset)]
    for index, exact in enumerate(derivatives(*at)):
        for entry in np.ndindex(at[index].shape):
            ends = []
            for step in (1e-6, -1e-6):
                moved = [value.copy() for value in at]
                moved[index][entry] += step
                ends.append(np.asarray(predicted(*moved)))
            numeric = (ends[0] - ends[1]) / 2e-6
            np.testing.assert_allclose(exact[(..., *entry)], numeric, rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("away", [0.0, 1e-12, -5.0])
def test_under_and_behind_the_camera_everything_is_finite(x64, away):
    K, R, t, center, person = drawn(0)
    person[:2] = center[0], center[1] + away
    values = predicted(matrix(K, R, t), person, center[:2], 0.15)
    slopes = derivatives(matrix(K, R, t), person, center[:2], 0.15)
    assert all(np.isfinite(part).all() for part in (values, *slopes))


@pytest.mark.slow
def test_the_projected_points_pass_through_a_lens(x64):
    K, R, t, center, person = drawn(1)
    pose, bend = np.column_stack([R, t]), np.array([-0.2, 0.05, 1e-3, -2e-3, 0.01])
    pixel = lambda point: K[:2, :2] @ cf.geometry.distort(point, bend) + K[:2, 2]  # noqa: E731
    found = box_edges(pose, jnp.asarray(person), jnp.asarray(center[:2]), 0.2, pixel)
    rig = Rig(K[None], R[None], t[None], (640, 480), bend[None])
    head, foot, imaged = people_in_rig(rig, 0, person[None], 0.2)
    assert imaged.all()
    np.testing.assert_allclose(found, edges_of(head, foot)[0], rtol=1e-9)


@pytest.mark.slow
@given(seeds, st.floats(0, 0.4))
def test_every_lens_shows_head_and_foot_where_opencv_does(x64, seed, offset):
    K, R, t, center, person = drawn(seed)
    toward = (center[:2] - person[:2]) / np.linalg.norm(center[:2] - person[:2])
    ends = np.stack([person, np.append(person[:2] + offset * toward, 0.0)])
    bend = np.array([-0.05, 0.01, 0.002, -0.001])
    turn = cv2.Rodrigues(R)[0]
    expected = [
        cv2.projectPoints(ends, turn, t, K, bend)[0],
        cv2.fisheye.projectPoints(ends[:, None], turn, t, K, bend)[0],
    ]
    lens = [Lens.PINHOLE, Lens.FISHEYE]
    bends = np.tile(np.append(bend, 0), (2, 1))
    rig = Rig(np.stack([K, K]), np.stack([R, R]), np.stack([t, t]), (640, 480), bends, lens=lens)
    head, foot, imaged = people_in_rig(rig, np.arange(2), np.stack([person] * 2), offset)
    assert imaged.all()
    np.testing.assert_allclose(
        np.stack([head, foot], 1), np.reshape(expected, (2, 2, 2)), rtol=1e-6, atol=1e-4
    )
    # The ray through the head passes the vertical at the person's height.
    place, up = np.append(person[:2], 0.0), np.array([0.0, 0.0, 1.0])
    for ray in rays_of_pixels(rig, np.arange(2), head):
        height = implied_height(center, ray, place, up, np.zeros(()))
        np.testing.assert_allclose(height, person[2], rtol=1e-6)


@pytest.mark.slow
@given(seeds)
def test_numpy_broadcasts_to_what_jax_computes_one_by_one(x64, seed):
    cases = [drawn(seed + i) for i in range(3)]
    pairs = [(matrix(*c[:3]), c[3][:2]) for c in cases]
    matrices, stations = (np.stack(a) for a in zip(*pairs, strict=True))
    people = np.stack([c[4] for c in cases])
    edges = box_edges(matrices[:, None], people[None], stations[:, None], 0.15)
    heights = height_at(matrices[:, None], people[None, :, :2], edges[..., 1])
    for i, j in np.ndindex(3, 3):
        one = matrices[i], people[j], stations[i], 0.15
        np.testing.assert_allclose(edges[i, j], predicted(*one), rtol=1e-9)
        if box_ends(*one)[2] > 0.1:
            assert heights[i, j] == pytest.approx(people[j, 2], rel=1e-6)


@pytest.mark.slow
def test_slopes_are_the_derivatives_of_the_edges(x64):
    K, R, t, center, person = drawn(3)
    at = (*map(jnp.asarray, (matrix(K, R, t), person, center[:2])), 0.15)
    edges, slopes = edges_and_slopes(*at)
    np.testing.assert_array_equal(edges, box_edges(*at))
    np.testing.assert_allclose(slopes, jax.jacfwd(box_edges, 1)(*at), rtol=1e-12)


def test_noise_is_a_share_of_the_box_and_a_floor():
    deviation = edge_deviation(np.array([0.0, 100.0, 1e6]), 0.03, 4.0)
    np.testing.assert_allclose(deviation, [4, 5, 3e4], rtol=1e-6)


def test_the_border_cuts_sides_tops_and_bottoms():
    inside = [100, 50, 150, 200]
    box = np.tile(np.array(inside, float), (5, 1))
    box[range(1, 5), range(4)] = [4, 2, 637, 476]
    cut = cut_by_border(box, np.array([640, 480]), 0.01)
    expected = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]]
    np.testing.assert_array_equal(cut, np.array(expected, bool))
