"""A camera that fits far worse than the others is found, whatever the scale of the residuals."""

from dataclasses import replace

import numpy as np
from hypothesis import given, strategies as st

from catfree.rig.calibrate import _relieved
from catfree.rig.pedestrians import refine_with_correspondences
from catfree.rig.strain import FEWEST_TO_COMPARE, STRAINED, most_strained
from catfree.rig.sure_people import sure_people
from catfree.settings import Settings
from catfree.synthetic import DetectorModel, RigError, make_world
from catfree.types import Rig, Scene

usual = st.floats(0.9, 1.1)


@given(
    st.lists(usual, min_size=FEWEST_TO_COMPARE, max_size=8),
    st.integers(0, 7),
    st.floats(0.01, 100.0),
    st.randoms(),
)
def test_the_one_that_stands_out(values, at, scale, random):
    residual = np.array(values)
    assert most_strained(residual * scale) is None
    at %= len(values)
    residual[at] = 1.2 * STRAINED * 1.1
    assert most_strained(residual * scale) == at
    assert most_strained(residual * scale, tried={at}) is None
    order = list(range(len(values)))
    random.shuffle(order)
    assert order[most_strained(residual[order])] == at


@given(st.lists(usual, min_size=FEWEST_TO_COMPARE, max_size=6), st.integers(1, 3))
def test_cameras_outside_the_rig_are_no_measure(values, missing):
    residual = np.array([5.0, *values, *[np.nan] * missing])
    assert most_strained(residual) == 0
    assert most_strained(np.full(5, np.nan)) is None


def test_few_cameras_bend_each_other():
    assert most_strained(np.array([1.0, 1.0, 9.0])) is None
    assert most_strained(np.zeros(0)) is None


def test_the_worst_of_two_comes_first():
    residual = np.array([1.0, 3.0, 1.0, 1.0, 4.0])
    assert most_strained(residual) == 4
    assert most_strained(residual, tried=[4]) == 1


def test_a_camera_beside_its_place_is_taken_to_it():
    detector = DetectorModel(pixel_noise=2.0, embedding_size=0, false_positives=0.3)
    world = make_world(
        "ring6", 3, frames=60, people=8, background=1, detector=detector,
        rig_error=RigError(0, 0, 0, 0, 0),
    )  # fmt: skip
    size, settings = world.true_rig.image_size, Settings()
    from catfree.rig.pedestrians import calibrate

    right = calibrate(world.detections, size)
    rig, wrong = right.scene.rig, 2
    t = np.array(rig.t)
    t[wrong] -= np.asarray(rig.R)[wrong] @ np.array([1.5, -1.0, 0.0])
    moved = Rig(rig.K, rig.R, t, rig.image_size, registered=rig.registered)
    beside = replace(right, scene=Scene.from_rig(moved, right.scene.ground, metric=True))
    people = sure_people(world.detections, right.scene, settings.evidence)
    judged = refine_with_correspondences(
        beside, world.detections, people.member, box_sd=people.box_sd, iterations=0
    )
    assert most_strained(judged.camera_residual) == wrong
    beside = replace(beside, camera_residual=judged.camera_residual, residual=judged.residual)
    found = _relieved(beside, world.detections, settings, lambda *_: None)
    assert most_strained(found.camera_residual) is None
    assert found.residual < beside.residual
    away = np.asarray(found.scene.rig.centers) - np.asarray(right.scene.rig.centers)
    assert np.linalg.norm(away, axis=1).max() < 0.3
