"""Little or useless input gives few or no positions; only an unusable rig is an error."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import catfree as cf
from catfree.errors import InsufficientDataError
from tests.methods.evidence.evidence_worlds import box_of, make_rig, make_scene

SCENE = make_scene(make_rig())
METHODS = [cf.Settings(), cf.Settings.paper()]


def boxes_at(xy, cameras, frame=0):
    rows = [box_of(SCENE.rig, camera, xy) for camera in cameras]
    count = len(rows)
    return cf.Detections(np.full(count, frame), np.array(cameras), np.array(rows))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=lambda s: s.method)
@pytest.mark.parametrize(
    "box",
    [
        [100.0, 20.0, 110.0, 30.0],  # above the horizon
        [0.0, 0.0, 1279.0, 719.0],  # cut on all sides
        [500.0, 0.0, 560.0, 300.0],  # the head is outside
    ],
)
def test_boxes_of_nobody_on_the_ground_give_no_positions(method, box):
    found = cf.localize(cf.Detections([0, 0], [0, 1], [box, box]), SCENE, method)
    assert len(found.tracks) == 0


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=lambda s: s.method)
def test_one_box_is_nobody_yet(method):
    assert len(cf.localize(boxes_at([0.5, 0.2], [1]), SCENE, method).tracks) == 0


@pytest.mark.slow
def test_one_person_of_one_instant_is_found():
    found = cf.localize(boxes_at([0.5, 0.2], [0, 1, 2, 3]), SCENE).tracks
    assert len(found) <= 1
    np.testing.assert_allclose(found.position[:, :2], [[0.5, 0.2]] * len(found), atol=0.1)


@pytest.mark.slow
@settings(max_examples=15)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 2),
            st.integers(0, 4),
            st.floats(-50, 1300),
            st.floats(-50, 760),
            st.floats(1, 500),
            st.floats(1, 700),
        ),
        max_size=6,
    )
)
def test_a_few_boxes_of_any_kind_never_fail(rows):
    table = np.array(rows).reshape(-1, 6)
    corner, size = table[:, 2:4], table[:, 4:]
    boxes = cf.Detections(
        table[:, 0].astype(int), table[:, 1].astype(int), np.hstack([corner, corner + size])
    )
    tracks = cf.localize(boxes, SCENE).tracks
    assert np.isfinite(tracks.position).all()
    assert np.isfinite(tracks.covariance).all()


def test_a_rig_of_one_registered_camera_stays_an_error():
    rig = SCENE.rig
    alone = cf.Rig(rig.K, rig.R, rig.t, rig.image_size, registered=np.arange(5) == 2)
    with pytest.raises(InsufficientDataError, match="2 registered"):
        cf.localize(boxes_at([0.5, 0.2], [2]), make_scene(alone))
