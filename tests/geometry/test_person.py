"""The box of a standing person: OpenCV's projection, finite differences, what moves the foot."""

import cv2
import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from catfree.geometry._person import box_edges

seeds = st.integers(0, 10**6)
predicted = jax.jit(box_edges)
derivatives = jax.jit(jax.jacfwd(box_edges, (0, 1, 2, 3)))


def drawn(seed):
    """A camera (K, R, t, center) that looks at a person (3,) from some meters away."""
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
    found = predicted(matrix(K, R, t), center[:2], person, offset)
    np.testing.assert_allclose(found, [(head[0] + foot[0]) / 2, head[1], foot[1]], rtol=1e-9)


@given(seeds, st.floats(0, 0.4))
def test_derivatives_are_those_of_finite_differences(x64, seed, offset):
    K, R, t, center, person = drawn(seed)
    at = [matrix(K, R, t), center[:2], person, np.array(offset)]
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
    values = predicted(matrix(K, R, t), center[:2], person, 0.15)
    slopes = derivatives(matrix(K, R, t), center[:2], person, 0.15)
    assert all(np.isfinite(part).all() for part in (values, *slopes))
