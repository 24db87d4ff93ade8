"""The published strategies: draws are as documented, and shrink to the plain case."""

import jax
import numpy as np
import pytest
from hypothesis import find, given, strategies as st

import catfree as cf
from catfree.errors import InvalidInputError
from catfree.testing import CLOSEST, observed, rotations, scenes, similarities

# The tests' shape checks inspect a random item of a sequence while a scene is drawn.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module")

to_rays = jax.jit(jax.vmap(cf.geometry.pixel_to_ray))


@given(rotations())
def test_rotations_are_rotations(R):
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)


@pytest.mark.slow
@given(similarities(scales=(0.5, 2.0), reach=3.0))
def test_similarities_keep_to_their_bounds(similarity):
    assert 0.499 < float(similarity.scale) < 2.001
    assert np.abs(similarity.translation).max() <= 3
    points = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    np.testing.assert_allclose(similarity.inverse()(similarity(points)), points, atol=1e-4)


@given(scenes())
def test_every_camera_sees_the_middle_from_above(scene):
    rig = scene.rig
    assert scene.metric
    assert 2 <= rig.camera_count <= 6
    assert (scene.ground.signed_distance(rig.centers) > 2).all()
    # The origin lies on the viewing axis, in front.
    np.testing.assert_allclose(rig.t[:, :2], 0, atol=1e-9)
    assert (rig.t[:, 2] > 0).all()
    np.testing.assert_allclose(np.linalg.det(rig.R), 1)


@pytest.mark.slow
@given(observed(), st.data())
def test_boxes_are_whole_and_their_foot_rays_meet_the_people(drawn, data):
    scene, positions, boxes = drawn
    cameras = scene.rig.camera_count
    assert len(boxes) == cameras * len(positions)
    assert (boxes.box >= 0).all()
    assert (boxes.box <= [1919, 1079, 1919, 1079]).all()
    rig, camera = scene.rig, boxes.camera
    origin, direction = map(
        np.asarray, to_rays(rig.K[camera], rig.R[camera], rig.t[camera], boxes.foot)
    )
    on_ground = (origin - origin[:, 2:] / direction[:, 2:] * direction)[:, :2]
    np.testing.assert_allclose(on_ground, np.tile(positions, (cameras, 1)), atol=2e-3)


@pytest.mark.slow
@given(observed(people=4))
def test_nobody_stands_too_close(drawn):
    gap = np.linalg.norm(drawn.positions[:, None] - drawn.positions[None], axis=-1)
    assert (gap[np.triu_indices(4, 1)] >= CLOSEST - 1e-9).all()


@given(scenes(cameras=3), st.integers(1, 4))
def test_numbers_can_be_asked_for(scene, people):
    assert scene.rig.camera_count == 3


def test_more_people_than_fit_are_refused():
    with pytest.raises(InvalidInputError, match="people is 5; it must be 1 to 4"):
        find(observed(people=5), lambda world: True)


@pytest.mark.parametrize("scales", [(0.0, 1.0), (2.0, 1.0), (1.0, np.inf), (np.nan, 1.0)])
def test_scales_are_positive(scales):
    with pytest.raises(InvalidInputError, match="must be two positive numbers in order"):
        similarities(scales)


@pytest.mark.slow
def test_shrinking_ends_at_the_plain_case():
    np.testing.assert_array_equal(find(rotations(), lambda R: True), np.eye(3))
    plain = find(scenes(), lambda scene: True)
    assert plain.rig.camera_count == 2
    np.testing.assert_allclose(plain.rig.centers, [[8, 0, 3], [-8, 0, 3]], atol=1e-9)
    identity = find(similarities(), lambda similarity: True)
    np.testing.assert_array_equal(identity.translation, np.zeros(3))
    assert float(identity.scale) == pytest.approx(1)


def test_importing_catfree_does_not_import_hypothesis():
    import subprocess
    import sys

    code = "import sys, catfree; print('hypothesis' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
