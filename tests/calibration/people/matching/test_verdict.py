"""A camera is trusted if nothing is lacking, and a refusal says what is."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration.people.matching._verdict import PlacementVerdict, _shortcomings
from catfree.settings import CalibrationSettings

SETTINGS = CalibrationSettings()


def verdict(matches: int, association: float, margin: float) -> PlacementVerdict:
    shortcomings = _shortcomings(association, matches, margin, SETTINGS)
    return PlacementVerdict(100.0, association, matches, margin, shortcomings)


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ((60, 0.3, 80.0), ["30 % of the people"]),
        ((60, 0.9, 20.0), ["evidence 20 above chance, more than 25 needed"]),
        ((600, 0.9, 50.0), ["evidence 50 above chance, more than 60 needed"]),
        ((3, 0.1, -5.0), ["10 %", "evidence -5"]),
        ((60, 0.9, np.nan), ["evidence nan"]),
    ],
)
def test_a_refusal_names_every_criterion_that_fails(case, words):
    found = verdict(*case)
    assert not found.accepted
    assert len(found.shortcomings) == len(words)
    for text, word in zip(found.shortcomings, words, strict=True):
        assert word in text


@given(
    st.integers(0, 300),
    st.floats(0.51, 1.0),
    st.floats(31.0, 1e3),
    st.integers(0, 50),
    st.floats(0.0, 0.5),
    st.floats(0.0, 100.0),
)
def test_more_of_everything_never_loses_trust(matches, association, margin, more, higher, surer):
    assert verdict(matches, association, margin).accepted
    better = verdict(matches + more, min(association + higher, 1.0), margin + surer + 0.1 * more)
    assert better.accepted
