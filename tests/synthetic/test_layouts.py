import inspect

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.errors import InvalidInputError
from catfree.synthetic._disturbance import arbitrary_gauge, disturb, disturb_ground
from catfree.synthetic._layouts import (
    ASSUMED_FOCALS,
    FOCAL_CLEARANCE,
    LAYOUTS,
    look_at,
    make_layout,
    ring,
)
from catfree.synthetic._silhouettes import project_points
from catfree.synthetic._simulated_detector import detect
from catfree.synthetic._world import make_world

NAMES = [*LAYOUTS, "ring4", "ring9"]


def covering(layout) -> np.ndarray:
    """Count cameras that see a whole 1.7 m person at each point of a grid over the area."""
    x = np.linspace(*layout.area[:2], 15)
    y = np.linspace(*layout.area[2:], 25)
    ground = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    count = np.zeros(len(ground), int)
    for camera in range(layout.rig.camera_count):
        whole = np.ones(len(ground), bool)
        for up in (0.0, 1.7):
            pixel, depth = project_points(layout.rig, camera, np.insert(ground, 2, up, axis=1))
            inside = (pixel >= 0) & (pixel < layout.rig.image_size[camera])
            whole &= inside.all(-1) & (depth > 0.5)
        count += whole
    return count


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@given(seed=st.integers(0, 2**32 - 1))
def test_layouts_are_seeded_rigs_above_the_ground_that_see_the_area(name, seed):
    layout, again = make_layout(name, seed), make_layout(name, seed)
    np.testing.assert_array_equal(layout.rig.K, again.rig.K)
    np.testing.assert_array_equal(layout.rig.t, again.rig.t)
    assert (layout.rig.centers[:, 2] > 1.9).all()
    assert not layout.scene.ground.signed_distance(np.zeros(3))
    # Fewer cameras see less: with four narrow ones, one camera alone sees a third of the square.
    needed = 0.6 if layout.rig.camera_count < 6 else 0.75
    assert np.mean(covering(layout) >= 2) > needed


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_focal_length_is_a_usual_guess(name, seed):
    layout = make_layout(name, seed)
    focal = layout.rig.K[:, 0, 0] / layout.rig.image_size[:, 0]
    ratio = np.abs(np.log(focal[:, None] / np.array(ASSUMED_FOCALS)))
    assert (ratio > FOCAL_CLEARANCE).all()


def test_camera_counts_and_uneven_coverage():
    counts = {name: make_layout(name).rig.camera_count for name in NAMES}
    assert counts == {
        "wildtrack": 7,
        "multiviewx": 6,
        "gmvd6": 6,
        "gmvd8": 8,
        "ring4": 4,
        "ring9": 9,
    }
    wildtrack = [covering(make_layout("wildtrack", seed)).reshape(25, 15) for seed in range(5)]
    near = np.mean([grid[:12].mean() for grid in wildtrack])
    far = np.mean([grid[-12:].mean() for grid in wildtrack])
    assert near > far + 1


def test_look_at_puts_the_target_in_the_middle_and_up_above():
    centre, target = np.array([3.0, -2.0, 4.0]), np.array([0.5, 1.0, 0.9])
    R = look_at(centre, target)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    x, y, z = R @ (target - centre)
    assert (x, y) == pytest.approx((0, 0), abs=1e-12)
    assert z == pytest.approx(np.linalg.norm(target - centre))
    assert (R @ [0, 0, 1.0])[1] < 0  # image y points down


def test_image_size_scales_the_picture_only():
    small, large = ring(4, image_size=(640, 360)), ring(4, image_size=(1280, 720))
    np.testing.assert_array_equal(small.rig.R, large.rig.R)
    np.testing.assert_allclose(small.rig.K[:, 0, 0] * 2, large.rig.K[:, 0, 0])


@pytest.mark.parametrize("name", ["ring1", "ring", "ringx", "wildtrackk"])
def test_unknown_layouts_are_named(name):
    with pytest.raises(InvalidInputError, match=name):
        make_layout(name)


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (make_layout, {"name": None}, "There is no layout None"),
        (make_layout, {"name": "wildtrack", "seed": -1}, "seed is -1; it must be 0 or more"),
        (ring, {"side": -1}, "side is -1; it must be a positive number"),
        (ring, {"fps": 0}, "fps is 0; it must be a positive number"),
        (ring, {"people": -1}, "people is -1; it must be 0 or more"),
        (ring, {"height": 3}, r"height must have shape \(2\), got \(\)"),
        (ring, {"image_size": None}, "image_size must hold whole numbers"),
        (make_world, {"rig_error": 3, "frames": 2}, "rig_error must be a RigError, got int"),
        (
            detect,
            {"walkers": None, "rig": None, "model": 3},
            "model must be a DetectorModel, got int",
        ),
        (disturb, {"rig": None}, "rig must be a Rig, got NoneType"),
        (arbitrary_gauge, {"scene": None}, "scene must be a Scene, got NoneType"),
        (
            disturb_ground,
            {"ground": None, "tilt_deg": 1, "offset": 1, "about": np.zeros(3)},
            "ground must be a Plane, got NoneType",
        ),
        (ring, {"cameras": 0}, "cameras is 0; it must be 1 or more"),
        (make_world, {"layout": None}, "layout must be a Layout, got NoneType"),
        (make_world, {"columns": np.zeros(3)}, r"columns must have shape \(n, 4\), got \(3,\)"),
    ],
)
def test_what_makes_no_layout_or_world_is_named(make, options, message):
    unchecked = inspect.unwrap(make)  # bypass the tests' type checks
    with pytest.raises(InvalidInputError, match=message):
        unchecked(**options)
