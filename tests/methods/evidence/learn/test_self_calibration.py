"""Few people change parameters within bounds, and parameters without data do not change."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import catfree as cf
from catfree.geometry import Similarity, transform_scene
from catfree.methods.evidence.learn._self_calibration import self_calibrate
from catfree.settings import EvidenceSettings
from tests.methods.evidence.evidence_worlds import make_scene, walk

RULES = EvidenceSettings()


@pytest.mark.slow
@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 3), st.floats(0.0, 0.3))
def test_the_calibration_error_is_never_beyond_its_bounds(seed, people, frames, off):
    _, detections, scene = walk(people=people, frames=frames, seed=seed)
    rig = scene.rig
    moved = np.asarray(rig.t) + off * np.random.default_rng(seed).standard_normal(rig.t.shape)
    rig = cf.Rig(np.asarray(rig.K), np.asarray(rig.R), moved, np.asarray(rig.image_size))
    _, learned = self_calibrate(detections, make_scene(rig), RULES)
    low, high = RULES.angular_noise_range
    assert low <= learned.angular <= high
    assert np.isfinite(learned.edge).all()
    if people * frames < RULES.fewest_samples:
        assert learned.angular == RULES.angular_noise
        np.testing.assert_array_equal(learned.field, 0.0)


@pytest.mark.parametrize("scale", [1e-6, 1e3, 1e4, 1e7])
def test_the_height_of_people_is_learned_in_any_unit(x64, scale):
    _, detections, scene = walk(people=4, frames=3)
    larger = transform_scene(Similarity(scale, np.eye(3), np.zeros(3)), scene, metric=False)
    height, noise = self_calibrate(detections, scene, RULES)
    scaled_height, same_noise = self_calibrate(detections, larger, RULES)
    assert scaled_height == pytest.approx(scale * height, rel=1e-9)
    assert same_noise.angular == pytest.approx(noise.angular, rel=1e-9)
