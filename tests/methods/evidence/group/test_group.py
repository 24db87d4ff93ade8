"""Grouping a run of frames at a time gives the groups of all frames together."""

import jax
import numpy as np
import pytest

from catfree.methods.evidence.group._appearance import Likeness, PairRatios
from catfree.methods.evidence.group._group import group
from catfree.methods.evidence.group._groups import priors_of
from catfree.methods.evidence.observe import _boxes as prepared
from catfree.methods.evidence.observe._measurement import measure_boxes, start_noise
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings import EvidenceSettings
from catfree.types import Detections
from tests.methods.evidence.evidence_worlds import HEIGHT, walk

RULES = EvidenceSettings()


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("with_looks", [False, True])
@pytest.mark.parametrize("with_priors", [False, True])
def test_runs_of_one_frame_give_the_groups_of_all_frames(monkeypatch, with_looks, with_priors):
    truth, seen, scene = walk(people=5, frames=6, seed=2)
    looks = np.random.default_rng(0).normal(size=(len(seen), 8)).astype(np.float32)
    seen = Detections(seen.frame, seen.camera, seen.box, embedding=looks)
    boxes = prepared.prepare_boxes(seen, scene.rig, RULES)
    noise, views = start_noise(5, RULES), ground_views(scene, HEIGHT, boxes)
    measured = measure_boxes(boxes, views, noise, RULES)
    priors = None
    if with_priors:
        place = (truth[:, 2:] @ np.asarray(scene.ground.basis)[:2] - views.origin) / HEIGHT
        mean = np.column_stack([place, np.ones(len(place))])
        precision = np.tile(100 * np.eye(3), (len(place), 1, 1))
        priors = priors_of(truth[:, 0].astype(int), precision, 100 * mean, noise)

    def grouped():
        ratios = None
        if with_looks:
            assert boxes.embedding is not None
            ratios = PairRatios(boxes.embedding, Likeness((0.5, 0.2), (1.0, 0.2), 4.0, 0.5))
        return group(boxes, measured, noise, RULES.gate, priors, ratios)

    whole = grouped()
    assert len(boxes.runs) == 1
    assert ((whole.member >= 0).sum(1) > 2).sum() > 6
    monkeypatch.setattr(prepared, "PAIRS_OF_A_RUN", 1)
    assert len(boxes.runs) == 6
    for part, expected in zip(*map(jax.tree.leaves, (grouped(), whole)), strict=True):
        np.testing.assert_array_equal(part, expected)
