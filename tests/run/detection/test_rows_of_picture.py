"""The rows of one picture, without a look at all others."""

import numpy as np
from hypothesis import given, strategies as st

from catfree._run.detection._rows_of_picture import rows_of_picture


@given(st.integers(0, 10**6), st.integers(0, 60), st.integers(0, 9), st.integers(0, 3))
def test_rows_of_a_picture_are_those_of_its_frame_and_camera(seed, n, frame, camera):
    rng = np.random.default_rng(seed)
    frames, cameras = np.sort(rng.integers(0, 8, n)), rng.integers(0, 3, n)
    np.testing.assert_array_equal(
        rows_of_picture(frames, cameras, frame, camera),
        np.flatnonzero((frames == frame) & (cameras == camera)),
    )
