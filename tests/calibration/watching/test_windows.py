"""Windows of a recording."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import scipy.stats
from hypothesis import given, strategies as st

from catfree.calibration.watching._windows import _begins, _middle_line


def evenly(low, high, steps):
    """Windows of a part of a recording, with boxes or without."""
    edges = np.linspace(low, high, max(1, (high - low) // steps) + 1).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges) if b > a]


@given(
    st.lists(st.integers(0, 2000), min_size=1, max_size=60),
    st.integers(4, 200),
    st.one_of(st.none(), st.integers(-5, 2005)),
)
def test_windows_divide_the_recording_evenly_where_there_are_boxes(frames, steps, since):
    occupied, length = np.array(frames), 2001
    seen = SimpleNamespace(first=0, step=1, steps=length, boxes=SimpleNamespace(frame=occupied))
    cut = 0 if since is None else min(max(since, 0), length)
    expected = [
        (begin, stop)
        for begin, stop in evenly(0, cut, steps) + evenly(cut, length, steps)
        if ((occupied >= begin) & (occupied < stop)).any()
    ]
    assert _begins.__wrapped__(seen, steps, since) == expected


def test_a_gap_has_no_windows():
    far = 10**12
    frames = np.array([0, 1, far, far + 1])
    seen = SimpleNamespace(first=0, step=1, steps=far + 2, boxes=SimpleNamespace(frame=frames))
    assert len(_begins.__wrapped__(seen, 50, None)) == 2


@given(
    st.lists(st.integers(-1000, 1000), min_size=2, max_size=20, unique=True).flatmap(
        lambda x: st.tuples(
            st.just(x), st.lists(st.floats(-50, 50), min_size=len(x), max_size=len(x))
        )
    )
)
def test_the_middle_line_is_that_of_theil_and_sen(points):
    x, y = np.array(points[0], np.float64), np.array(points[1])
    expected = scipy.stats.theilslopes(y, x)
    line = [expected.slope, expected.intercept]
    np.testing.assert_allclose(_middle_line(x, y), line, rtol=1e-9, atol=1e-9)
