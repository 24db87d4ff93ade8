"""Long sequences and other settings cause no further memory use or compilation."""

import dataclasses

import numpy as np
import pytest

from catfree.methods.evidence import EvidenceSettings, localize_by_evidence
from catfree.methods.evidence.observe import _boxes as prepared
from catfree.methods.evidence.observe._measurement import measure_all
from catfree.synthetic import make_world

pytestmark = pytest.mark.slow

WORLD = make_world("ring4", 7, frames=10, people=6)


def test_a_few_frames_at_a_time_give_the_same_people(monkeypatch):
    whole = localize_by_evidence(WORLD.detections, WORLD.scene).tracks
    assert len(np.unique(whole.track_id)) > 3
    monkeypatch.setattr(prepared, "PAIRS_OF_A_RUN", 3 * 32**2)
    parts = localize_by_evidence(WORLD.detections, WORLD.scene).tracks
    np.testing.assert_array_equal(parts.track_id, whole.track_id)
    np.testing.assert_allclose(parts.position, whole.position, rtol=1e-12)


def test_other_numbers_compile_nothing_new():
    boxes = WORLD.detections[WORLD.detections.frame < 4]
    localize_by_evidence(boxes, WORLD.scene)
    before = measure_all._cache_size()
    other = dataclasses.replace(EvidenceSettings(), cover_slope=3.0, foot_outlier=0.05)
    localize_by_evidence(boxes, WORLD.scene, other)
    assert measure_all._cache_size() == before
