"""Windows of a recording."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
from hypothesis import given, strategies as st

from catfree.calibration.watching._windows import _begins


def evenly(low, high, steps):
    """Make windows of a part of a recording, with boxes or without."""
    count = max(1, (high - low) // steps)
    edges = [low + k * (high - low) // count for k in range(count + 1)]
    return [(a, b) for a, b in pairwise(edges) if b > a]


@given(
    st.lists(st.integers(0, 2000), min_size=1, max_size=60),
    st.integers(4, 200),
    st.integers(-5, 2005),
)
def test_windows_divide_the_recording_evenly_where_there_are_boxes(frames, steps, since):
    occupied, length = np.array(frames), 2001
    seen = SimpleNamespace(first=0, step=1, steps=length, boxes=SimpleNamespace(frame=occupied))
    cut = min(max(since, 0), length)
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
    assert len(_begins.__wrapped__(seen, 50, 0)) == 2
