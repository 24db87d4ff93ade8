"""The two-state chain, compared with the sum over all histories."""

import itertools

import numpy as np
from hypothesis import given, strategies as st

from catfree.methods.evidence.track._presence import chain_weights, presence
from catfree.methods.evidence.track._tracking import Trails

tracks = st.lists(st.lists(st.floats(-5, 5), min_size=1, max_size=7), max_size=4)


def trails_of(lengths):
    """Make tracks with these numbers of frames, numbered 3, 5, 7, ..."""
    track = np.repeat(3 + 2 * np.arange(len(lengths)), lengths)
    frame = np.concatenate([np.arange(n) for n in lengths]) if lengths else np.zeros(0, int)
    n = len(track)
    return Trails(track, frame.astype(int), np.arange(n), np.zeros((n, 5)), np.zeros((n, 5, 5)))


def by_histories(evidence, change):
    """Compute the probability of presence in each frame of one track."""
    n = len(evidence)
    on, total = np.zeros(n), 0.0
    for history in itertools.product([0, 1], repeat=n):
        h = np.array(history)
        # The person may leave at the last frame at no cost.
        starts = (np.diff(np.r_[0, h]) == 1).sum()
        stops = (np.diff(h) == -1).sum()
        weight = np.exp(h @ np.array(evidence) - change * (starts + stops))
        on, total = on + weight * h, total + weight
    return on / total


@given(tracks, st.floats(0, 6))
def test_presence_is_the_sum_over_all_histories(evidence, change):
    trails = trails_of([len(one) for one in evidence])
    found = presence(trails, np.array(list(itertools.chain(*evidence)), float), change)
    expected = [by_histories(one, change) for one in evidence]
    np.testing.assert_allclose(found, np.concatenate([*expected, []]), rtol=1e-6, atol=1e-9)


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=6), st.floats(0, 6))
def test_later_frames_weigh_all_continuations(evidence, change):
    n = len(evidence)
    weights = chain_weights(trails_of([n]), np.array(evidence), change, last=True)
    for row in range(n):
        sums = np.zeros(2)
        for h in itertools.product([0, 1], repeat=n - row):
            switches = np.abs(np.diff(h)).sum()
            sums[1 - h[0]] += np.exp(np.dot(h, evidence[row:]) - change * switches)
        odds = weights[row, 0] - weights[row, 1]
        np.testing.assert_allclose(odds, np.log(sums[0] / sums[1]), atol=1e-9)
