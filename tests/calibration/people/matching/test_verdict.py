"""A camera is trusted if nothing is lacking, and a refusal says what is."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration.people.matching._verdict import PlacementVerdict, _shortcomings
from catfree.settings import CalibrationSettings

SETTINGS = CalibrationSettings()


def verdict(association: float, margin: float) -> PlacementVerdict:
    return PlacementVerdict(
        100.0, association, 60, margin, _shortcomings(association, margin, SETTINGS)
    )


@pytest.mark.parametrize(
    ("association", "margin", "words"),
    [
        (0.3, 80.0, ["30 % of the people"]),
        (0.9, 20.0, ["evidence 20 above chance, more than 25 needed"]),
        (0.1, -5.0, ["10 %", "evidence -5"]),
        (0.9, np.nan, ["evidence nan"]),
    ],
)
def test_a_refusal_names_every_criterion_that_fails(association, margin, words):
    found = verdict(association, margin)
    assert not found.accepted
    assert len(found.shortcomings) == len(words)
    for text, word in zip(found.shortcomings, words, strict=True):
        assert word in text


@given(
    st.floats(0.51, 1.0),
    st.floats(26.0, 1e3),
    st.floats(0.0, 0.5),
    st.floats(0.0, 100.0),
)
def test_more_of_everything_never_loses_trust(association, margin, higher, surer):
    assert verdict(association, margin).accepted
    assert verdict(min(association + higher, 1.0), margin + surer).accepted
