import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from catfree.geometry._similarity import transform_scene
from catfree.synthetic._disturbance import arbitrary_gauge, disturb, disturb_ground
from catfree.synthetic._layouts import make_layout
from catfree.synthetic._silhouettes import project_points

SCENE = make_layout("ring5", 4).scene
POINTS = np.array([[0.0, 0.0, 0.0], [2.0, -3.0, 1.7], [-5.0, 4.0, 0.3]])
seeds = st.integers(0, 2**32 - 1)


@given(
    seed=seeds,
    rotation=st.floats(0, 20),
    centre=st.floats(0, 5),
    focal=st.floats(0, 0.3),
)
def test_every_camera_is_off_by_exactly_the_stated_amounts(seed, rotation, centre, focal):
    rig = SCENE.rig
    wrong = disturb(rig, rotation_deg=rotation, centre=centre, focal=focal, seed=seed)
    turn = Rotation.from_matrix(wrong.R @ rig.R.transpose(0, 2, 1)).magnitude()
    np.testing.assert_allclose(np.rad2deg(turn), rotation, atol=1e-6)
    shift = np.linalg.norm(wrong.centers - rig.centers, axis=-1)
    np.testing.assert_allclose(shift, centre, atol=1e-9)
    np.testing.assert_allclose(np.abs(wrong.K[:, 0, 0] / rig.K[:, 0, 0] - 1), focal, atol=1e-12)
    np.testing.assert_allclose(wrong.K[:, 1, 1] / rig.K[:, 1, 1], wrong.K[:, 0, 0] / rig.K[:, 0, 0])
    np.testing.assert_array_equal(wrong.K[:, :2, 2], rig.K[:, :2, 2])


@given(seed=seeds, tilt=st.floats(0, 10), offset=st.floats(0, 2))
def test_ground_is_off_by_exactly_the_stated_amounts(seed, tilt, offset):
    about = np.array([1.0, 2.0, 0.0])
    wrong = disturb_ground(SCENE.ground, tilt_deg=tilt, offset=offset, about=about, seed=seed)
    sine = np.linalg.norm(np.cross(wrong.normal, SCENE.ground.normal))
    assert np.rad2deg(np.arcsin(sine)) == pytest.approx(tilt, abs=1e-6)
    # The vertical gap below `about` is the offset: height of the plane above it, along the true
    # normal.
    gap = wrong.signed_distance(about) / (wrong.normal @ SCENE.ground.normal)
    assert abs(gap) == pytest.approx(offset, abs=1e-9)


@pytest.mark.slow
@given(seed=seeds)
def test_gauge_moves_no_pixel_and_round_trips(x64, seed):
    scene, gauge = arbitrary_gauge(SCENE, seed)
    for camera in range(SCENE.rig.camera_count):
        before, depth_before = project_points(SCENE.rig, camera, POINTS)
        after, depth_after = project_points(scene.rig, camera, np.asarray(gauge(POINTS)))
        # Depths are kept off zero by an absolute length: compare points in front only.
        front = depth_after > 2e-3
        np.testing.assert_array_equal(depth_before > 0, depth_after > 0)
        np.testing.assert_allclose(after[front], before[front], atol=1e-6)
    np.testing.assert_allclose(
        scene.ground.signed_distance(np.asarray(gauge(POINTS))),
        float(gauge.scale) * SCENE.ground.signed_distance(POINTS),
        atol=1e-9,
    )
    assert float(scene.extent) == pytest.approx(float(gauge.scale) * float(SCENE.extent))
    assert not scene.metric
    np.testing.assert_allclose(gauge.inverse()(gauge(POINTS)), POINTS, atol=1e-9)
    back = transform_scene(gauge.inverse(), scene, metric=True)
    np.testing.assert_allclose(back.rig.R, SCENE.rig.R, atol=1e-12)
    np.testing.assert_allclose(back.rig.t, SCENE.rig.t, atol=1e-9)
    np.testing.assert_allclose(back.ground.normal, SCENE.ground.normal, atol=1e-12)
    np.testing.assert_allclose(back.ground.offset, SCENE.ground.offset, atol=1e-9)


def test_gauge_is_seeded_and_differs_between_seeds():
    scales = {float(arbitrary_gauge(SCENE, seed)[1].scale) for seed in (0, 0, 1, 2)}
    assert len(scales) == 3
