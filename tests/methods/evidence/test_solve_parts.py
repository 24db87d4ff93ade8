import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence._gaussian import probability_within
from catfree.methods.evidence.observe._boxes import undistorted_pixels
from catfree.methods.evidence.observe._hidden_shares import COLUMNS, hidden_shares
from catfree.types import Rig


@settings(max_examples=10)
@given(st.floats(0.05, 1), st.floats(0.05, 1), st.floats(0, 3), st.floats(0.1, 1))
def test_probability_within_a_radius_matches_sampling(a, b, angle, radius):
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    covariance = R @ np.diag([a**2, b**2]) @ R.T
    points = np.random.default_rng(1).multivariate_normal([0, 0], covariance, 40000)
    share = (np.linalg.norm(points, axis=1) < radius).mean()
    assert abs(probability_within(covariance[None], radius)[0] - share) < 0.012


@pytest.mark.slow
def test_a_box_hides_what_lies_below_its_top():
    region = np.tile([0.0, 0.0, 8.0, 10.0], (2, 1))
    box = np.array([[-1.0, 5.0, 3.9, 12.0], [0.0, 0.0, 8.0, 9.0], [2.0, 8.0, 9.0, 11.0]])
    # The first hides the lower half of half the columns; the second ends higher, so it is behind.
    nobody, camera, first = np.full(2, -1), np.arange(2), np.zeros(2, int)
    table = np.array([[[0, 1, -1], [0, 1, 2]]])
    found = hidden_shares(region, nobody, first, camera, box, table)
    assert found == pytest.approx([0.25, 0.35])
    assert COLUMNS == 8


@pytest.mark.slow
@given(st.floats(-0.15, 0.1), st.floats(100, 1180), st.floats(100, 620))
def test_undistorted_pixels_distort_back(k1, u, v):
    K = np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]])
    rig = Rig(K[None], np.eye(3)[None], np.zeros((1, 3)), (1280, 720), [[k1, 0.02, 1e-3, -1e-3, 0]])
    ideal = undistorted_pixels(rig, np.zeros(1, int), np.array([[u, v]]))[0]
    x, y = (ideal[0] - 640) / 900, (ideal[1] - 360) / 900
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + 0.02 * r2**2
    back = [
        900 * (x * radial + 2e-3 * x * y - 1e-3 * (r2 + 2 * x * x)) + 640,
        900 * (y * radial + 1e-3 * (r2 + 2 * y * y) - 2e-3 * x * y) + 360,
    ]
    np.testing.assert_allclose(back, [u, v], atol=1e-3)
