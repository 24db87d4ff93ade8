import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.geometry._similarity import transform_scene
from catfree.geometry.camera import pixels_of_points
from catfree.synthetic import RigError, angular_residuals, make_world
from catfree.synthetic._layouts import shop

NO_ERROR = RigError(0.0, 0.0, 0.0, 0.0, 0.0)


def in_metres(world):
    """Return the recovered scene without its arbitrary gauge."""
    return transform_scene(world.scene_from_world.inverse(), world.scene, metric=True)


@pytest.mark.slow
@given(seed=st.integers(0, 10_000))
def test_small_worlds_are_consistent(seed):
    world = make_world("ring4", seed, frames=10, people=6)
    again = make_world("ring4", seed, frames=10, people=6)
    np.testing.assert_array_equal(world.detections.box, again.detections.box)
    np.testing.assert_array_equal(world.scene.rig.t, again.scene.rig.t)
    assert len(world.identities) == len(world.detections)
    assert world.scene.rig.camera_count == 4
    x, y = world.ground_truth[:, 2], world.ground_truth[:, 3]
    x_min, x_max, y_min, y_max = world.area
    assert ((x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)).all()
    assert (world.scene.ground.signed_distance(world.scene.rig.centers) > 0).all()


@pytest.mark.slow
@given(seed=st.integers(0, 10_000))
def test_the_recovered_scene_is_the_true_one_but_for_the_stated_error(x64, seed):
    exact = make_world("ring4", seed, frames=1, people=1, rig_error=NO_ERROR)
    back = in_metres(exact)
    np.testing.assert_allclose(back.rig.centers, exact.true_centres, atol=1e-9)
    np.testing.assert_allclose(back.rig.R, exact.true_rig.R, atol=1e-12)
    wrong = make_world("ring4", seed, frames=1, people=1, rig_error=RigError(centre=0.3))
    back = in_metres(wrong)
    shift = np.linalg.norm(back.rig.centers - wrong.true_centres, axis=-1)
    np.testing.assert_allclose(shift, 0.3, atol=1e-9)


@pytest.mark.slow
def test_residuals_of_rays_are_what_the_documentation_states():
    detector, with_default, with_degree = [], [], []
    for name in ("ring6", "multiviewx", "wildtrack", "gmvd6", "gmvd8"):
        for medians, error in (
            (with_default, RigError()),
            (with_degree, RigError(rotation_deg=1.0)),
        ):
            world = make_world(name, 0, frames=20, rig_error=error)
            recovered = in_metres(world).rig
            medians.append(np.median(angular_residuals(world, recovered)))
        detector.append(np.median(angular_residuals(world)))
    assert 0.002 < min(detector) <= max(detector) < 0.013
    assert 0.008 < min(with_default) <= max(with_default) < 0.021
    assert 0.014 < min(with_degree) <= max(with_degree) < 0.025


def test_rays_of_exact_feet_meet_their_people_through_any_lens():
    world = make_world(shop(fisheye=True), 0, frames=3)
    seen, person = world.detections, np.maximum(world.identities, 0)
    feet = np.pad(world.walkers.position[seen.frame, person], ((0, 0), (0, 1)))
    pixel, _ = pixels_of_points(world.true_rig, seen.camera, feet)
    box = np.tile(pixel, 2) + np.array([-5, -20, 5, 0])
    exact = replace(world, detections=replace(seen, box=box))
    np.testing.assert_allclose(angular_residuals(exact), 0, atol=1e-6)


def test_small_worlds_are_fast():
    make_world("ring4", 0, frames=10, people=6)
    start = time.process_time()
    make_world("ring4", 1, frames=10, people=6)
    assert time.process_time() - start < 1.0  # 0.02 s; twenty times that under the shape checks


@pytest.mark.slow
@pytest.mark.parametrize(("people", "background"), [(20, 10), (5, 0)])
def test_population_is_what_was_asked_for(people, background):
    world = make_world("gmvd6", 1, frames=50, people=people, background=background)
    per_frame = np.bincount(world.ground_truth[:, 0].astype(int), minlength=50)
    assert abs(per_frame.mean() - people) < 0.3 * people
    assert world.walkers.background.sum() == background
