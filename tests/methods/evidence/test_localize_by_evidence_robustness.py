"""Worse input makes worse results, but gradually, and never worse than the paper's method."""

import numpy as np
import pytest

import catfree as cf
from benchmarks.paper.scoring import score
from benchmarks.robustness import (
    CHANGES,
    ROLL,
    distorted,
    modas,
    simulated,
    thinned,
    with_dropped_frames,
    with_false_boxes,
)
from catfree.methods.evidence.observe._boxes import undistorted_pixels
from catfree.synthetic import RigError

pytestmark = pytest.mark.slow

FRAMES = 8


@pytest.fixture(scope="module")
def world():
    return simulated("ring6", 8, frames=FRAMES)


@pytest.fixture(scope="module")
def clean(world):
    """Compute both methods' MODA before any change."""
    return modas(world)


def assert_costs_no_more_than_the_paper(clean, changed, world):
    """Check that evidence is ahead and loses no more than the paper's method, plus one person."""
    (paper, evidence), person = changed, 100 / len(world.ground_truth)
    assert evidence >= paper
    assert clean[1] - evidence <= max(clean[0] - paper, 0) + person * (1 + 1e-9)


@pytest.mark.parametrize(
    "name",
    [
        "50 % of the boxes",
        "30 % false boxes",
        "lenses k1 = -0.1, corrected",
        "lenses k1 = -0.1, not corrected",
    ],
)
def test_bad_input_costs_less_than_it_costs_the_papers_method(world, clean, name):
    assert_costs_no_more_than_the_paper(clean, modas(CHANGES[name](world)), world)


def test_a_rolled_camera_is_understood(world, clean):
    rolled = simulated("ring6", 8, frames=FRAMES, roll=ROLL)
    assert_costs_no_more_than_the_paper(clean, modas(rolled), world)


@pytest.mark.parametrize(
    ("layout", "seed", "degrees"), [("gmvd8", 33, 0.5), ("wildtrack", 38, 1.0)]
)
def test_cameras_that_disagree_make_no_camps(layout, seed, degrees):
    """Each group of cameras would report every person at its own place, or no one at all."""
    rig_error = RigError(rotation_deg=degrees)
    sequence = simulated(layout, seed, frames=6, rig_error=rig_error)
    found, paper = (
        score(cf.localize(sequence.detections, sequence.scene, rules), sequence).detection
        for rules in (cf.Settings(), cf.Settings.paper())
    )
    assert found.tp > paper.tp
    assert found.fp < paper.fp


def test_a_camera_that_drops_frames_costs_nothing(world):
    def moda(sequence):
        return score(cf.localize(sequence.detections, sequence.scene), sequence).moda

    assert moda(with_dropped_frames(world, 0.2)) > moda(world) - 2


def test_the_changes_are_what_they_say(world):
    boxes = world.detections
    assert len(thinned(world, 0.5).detections) == pytest.approx(0.5 * len(boxes), rel=0.1)
    false = len(with_false_boxes(world, 0.3).detections) - len(boxes)
    assert false / (false + len(boxes)) == pytest.approx(0.3, abs=0.01)
    lost = with_dropped_frames(world, 0.25).detections
    assert len(np.unique(lost.frame[lost.camera == 1])) == FRAMES - 2
    assert (lost.camera != 1).sum() == (boxes.camera != 1).sum()
    bent = distorted(world, -0.1, known=True)
    rig, lens = world.scene.rig, bent.scene.rig
    size = np.asarray(rig.image_size)[boxes.camera]
    whole = (boxes.box[:, :2] > 10).all(1) & (boxes.box[:, 2:] < size - 10).all(1)
    feet = np.stack([bent.detections.box[:, [0, 2]].mean(1), bent.detections.box[:, 3]], -1)
    corner = (np.asarray(rig.K) - np.asarray(lens.K))[boxes.camera, :2, 2]
    straight = undistorted_pixels(lens, boxes.camera, feet) + corner
    # Each side's middle is distorted separately, so the foot point is right to a pixel or two.
    error = np.abs(straight - np.stack([boxes.box[:, [0, 2]].mean(1), boxes.box[:, 3]], -1))
    assert np.median(error[whole]) < 1 < np.median(np.abs(bent.detections.box - boxes.box))
    assert (np.asarray(lens.image_size) < np.asarray(rig.image_size)).all()
    assert (bent.detections.box[:, 2:] <= np.asarray(lens.image_size)[boxes.camera] - 0.5).all()
