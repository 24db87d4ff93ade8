"""Detections as padded arrays."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree.methods.evidence.observe._boxes import LONGEST_PAUSE, prepare_boxes
from catfree.settings import EvidenceSettings
from catfree.synthetic import make_world
from tests.methods.evidence.evidence_worlds import make_rig

RIG = make_rig()


def boxes_at(frames):
    count = len(frames)
    box = np.tile([300.0, 200.0, 340.0, 300.0], (count, 1))
    detections = cf.Detections(np.array(frames), np.zeros(count, int), box)
    return prepare_boxes(detections, RIG, EvidenceSettings())


@given(
    st.lists(st.integers(1, 10**5), min_size=1, max_size=20),
    st.integers(-(2**62), 0),
    st.sampled_from([1, 40_000, 40_000_000]),
)
def test_time_counts_usual_steps_from_the_first_frame(steps, first, unit):
    frames = first + unit * np.cumsum([0, *steps])
    usual = np.median(np.diff(frames))
    found = boxes_at(frames)
    np.testing.assert_allclose(found.time, (frames - first) / usual, rtol=1e-12)


@given(st.integers(10**6, 2**52))
def test_no_pause_is_longer_than_the_longest(pause):
    frames = np.array([0, 1, 2, 2 + pause, 3 + pause])
    np.testing.assert_array_equal(
        boxes_at(frames).time, [0, 1, 2, 2 + LONGEST_PAUSE, 3 + LONGEST_PAUSE]
    )


@pytest.mark.slow
def test_people_before_and_after_an_endless_pause_are_located_as_without():
    world = make_world("ring4", frames=20, people=6)
    boxes = world.detections
    later = replace(boxes, frame=np.where(boxes.frame > 9, boxes.frame + 10**9, boxes.frame))
    near, far = (cf.localize(d, world.true_scene).tracks for d in (boxes, later))
    assert np.isfinite(far.sigma).all()
    assert abs(len(far) - len(near)) <= 0.02 * len(near)
    clocks = cf.estimate_clocks(world.true_scene, later)  # must be quick
    assert np.isfinite(clocks.offset_sd).all()
