"""Hidden shares, counted pixel by pixel."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence.observe._boxes import prepare_boxes
from catfree.methods.evidence.observe._hidden_shares import COLUMNS, hidden_shares
from catfree.settings import EvidenceSettings
from catfree.types import Detections
from tests.methods.evidence.evidence_worlds import make_rig

SIDE = 16
whole = st.integers(-4, SIDE + 4)


@st.composite
def rectangles(draw, low=1):
    """Draw boxes with corners on whole pixels."""
    x, y = draw(whole), draw(whole)
    return [
        float(v) for v in (x, y, x + draw(st.integers(low, 12)), y + draw(st.integers(low, 30)))
    ]


@pytest.mark.slow
@settings(max_examples=60)
@given(st.lists(rectangles(), min_size=1, max_size=6).map(np.array), st.data())
def test_the_hidden_share_is_that_of_pixels_inside_nearer_boxes(others, data):
    flags = st.lists(
        st.sampled_from([True, True, False]), min_size=len(others), max_size=len(others)
    )
    active = np.array(data.draw(flags))
    # A nearer person stands lower, and hides everything in the box's columns below its top.
    nearer = active & (others[:, 3] > SIDE)
    columns = (np.arange(COLUMNS) + 0.5) * SIDE / COLUMNS
    rows = np.arange(SIDE)[:, None] + 0.5
    hidden = np.zeros((SIDE, COLUMNS), bool)
    for left, top, right, _ in others[nearer]:
        hidden |= (rows > top) & (columns >= left) & (columns <= right)
    region = np.array([[0.0, 0.0, SIDE, SIDE]])
    table = np.where(active, np.arange(len(others)), -1)[None, None]
    first = np.zeros(1, int)
    found = hidden_shares(region, np.array([-1]), first, first, others, table)
    assert found[0] == pytest.approx(hidden.mean())


def test_only_boxes_that_stand_in_front_of_the_feet_hide_them():
    box = np.array(
        [
            [100.0, 100, 200, 400],  # feet from row 310 on
            [100.0, 370, 200, 500],  # in front: hides a third of them
            [100.0, 100, 200, 399],  # behind
            [150.0, 355, 300, 500],  # in front, but in another camera
            [150.0, 310, 300, 500],  # in front, but at another time
        ]
    )
    camera, frame = np.array([0, 0, 0, 1, 0]), np.array([0, 0, 0, 0, 1])
    boxes = prepare_boxes(
        Detections(frame, camera, box), make_rig(2), EvidenceSettings(lower_body=0.3)
    )
    found = boxes.covered[np.argsort(boxes.row)]
    assert found[0] == pytest.approx(1 / 3)
    assert found[1] == found[3] == found[4] == 0
    assert found[2] == 1  # by the first, which stands a pixel lower
