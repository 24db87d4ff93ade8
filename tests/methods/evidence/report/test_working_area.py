import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.methods.evidence import EvidenceSettings
from catfree.methods.evidence.observe._measurement import start_noise
from catfree.methods.evidence.observe._views import (
    GroundViews,
    ground_views,
    people_in_cameras,
)
from catfree.methods.evidence.observe._visibility import Views
from catfree.methods.evidence.report._working_area import (
    coverage_of,
    in_working_area,
    usual_place,
)
from tests.methods.evidence.evidence_worlds import HEIGHT, make_rig, make_scene

SETTINGS = EvidenceSettings()
CAMERAS = 6


def within(share, away=None):
    """Return whether people with these shares of their body in the images are in the area.

    They all stand in the middle, equally well seen otherwise, or (n,) H0 `away` from it.
    """
    share = np.asarray(share, float)
    views = ground_views(make_scene(make_rig(CAMERAS)), HEIGHT)
    return judge(share, views, np.zeros(len(share)) if away is None else np.asarray(away))


def judge(share, views: GroundViews, away, cameras=CAMERAS):
    state = np.column_stack([away, np.zeros(len(away)), np.ones(len(away))])
    _, front = people_in_cameras(state, views)
    seen = Views(front.astype(float), np.full_like(share, 100.0), 0 * share, share)
    noise = start_noise(share.shape[1], SETTINGS)
    seeing = np.ones(share.shape[1], bool)
    coverage = coverage_of(state, seen, seeing, views, noise, SETTINGS)
    return in_working_area(apart(len(coverage)), coverage, cameras, SETTINGS)


def apart(count):
    """Make positions at distinct places."""
    return np.column_stack([np.arange(count) + 0.5, np.zeros(count)])


def covered(whole):
    """Make places with equal coverage, except for the number of images with the whole body."""
    return np.column_stack([np.full(len(whole), 0.02), whole])


def shares(people):
    """Draw shares of the body in the images: none, cut, whole."""
    one = st.lists(st.sampled_from([0.0, 0.5, 1.0]), min_size=CAMERAS, max_size=CAMERAS)
    return st.lists(one, min_size=people[0], max_size=people[1]).map(np.array)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@settings(max_examples=20, deadline=None)
@given(shares((1, 12)), st.permutations(range(CAMERAS)))
def test_the_order_of_the_cameras_says_nothing(share, order):
    np.testing.assert_array_equal(within(share), within(share[:, order]))


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@settings(max_examples=30, deadline=None)
@given(shares((1, 12)), st.data())
def test_another_image_of_the_whole_body_takes_nobody_out(share, data):
    person = data.draw(st.integers(0, len(share) - 1))
    camera = data.draw(st.integers(0, CAMERAS - 1))
    before = within(share)[person]
    share[person, camera] = 1.0
    assert within(share)[person] >= before


@pytest.mark.slow
def test_a_place_is_left_when_half_of_the_rig_has_turned_away():
    everywhere = [[1.0] * 6] * 8
    np.testing.assert_array_equal(
        within([*everywhere, [1, 1, 1, 1, 0, 0], [1, 1, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]]),
        [True] * 9 + [False, False],
    )


@pytest.mark.slow
def test_where_two_fifths_of_the_places_are_nobody_is_excluded():
    near, far = [1.0] * 6, [1, 1, 0, 0, 0, 0]
    np.testing.assert_array_equal(within([near] * 7 + [far] * 4), [True] * 7 + [False] * 4)
    assert within([near] * 6 + [far] * 4).all()


@pytest.mark.slow
def test_three_images_of_the_whole_body_are_enough_anywhere():
    everywhere = [[1.0] * 6] * 7
    few = [[1, 1, 1, 0, 0, 0], [1, 0, 0, 1, 0, 1], [1, 1, 0.5, 0.5, 0.5, 0.5]]
    np.testing.assert_array_equal(within([*everywhere, *few]), [True] * 9 + [False])


@pytest.mark.slow
def test_where_people_are_usually_in_few_images_two_are_enough():
    usual = [[1, 1, 1, 1, 0, 0], [0, 1, 1, 1, 1, 0], [0, 0, 1, 1, 1, 1]]
    np.testing.assert_array_equal(
        within([*usual, *usual, [1, 1, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]]), [True] * 7 + [False]
    )


@pytest.mark.parametrize("cameras", [2, 4])
def test_where_people_are_usually_in_fewer_than_three_images_nobody_is_excluded(cameras):
    whole = np.repeat([2, 0], [9, 1])
    found = in_working_area(apart(10), covered(whole), cameras, SETTINGS)
    assert found.all()


@pytest.mark.slow
def test_where_people_are_in_half_of_the_images_nobody_is_excluded():
    assert within([[1, 1, 1, 0, 0, 0], [0, 0, 1, 1, 0, 0], [1, 1, 0, 0, 0, 0], [0] * 6]).all()


@pytest.mark.slow
def test_cameras_that_see_nobody_do_not_count():
    share = np.array([[1.0] * 4 + [0.0] * 2] * 5 + [[1.0] * 2 + [0.0] * 4])
    views = ground_views(make_scene(make_rig(CAMERAS)), HEIGHT)
    assert judge(share, views, np.zeros(6)).all()
    found = judge(share, views, np.zeros(6), cameras=4)
    np.testing.assert_array_equal(found, [True] * 5 + [False])


@pytest.mark.slow
def test_a_cut_body_is_not_seen_but_a_hand_outside_cuts_nobody():
    everywhere = [[1.0] * 6] * 5
    np.testing.assert_array_equal(
        within([*everywhere, [0.97] * 6, [1, 1, 0.6, 0.6, 0.6, 0.6]]), [True] * 6 + [False]
    )


@pytest.mark.slow
def test_a_place_far_off_is_vague():
    found = within([[1.0] * 6] * 8, away=[0, 0.5, 1, -0.5, -1, 0.2, 300, 310])
    np.testing.assert_array_equal(found, [True] * 6 + [False] * 2)


@settings(deadline=None)
@given(
    st.lists(st.floats(0.02, 0.03), min_size=20, max_size=60),
    st.lists(st.floats(1e-4, 1e-3), min_size=1, max_size=8),
)
def test_a_few_people_close_to_a_camera_take_nobody_out(usual, close):
    sigma = np.array([*usual, *close])
    whole = np.full(len(sigma), 4)
    assert in_working_area(apart(len(sigma)), np.column_stack([sigma, whole]), 4, SETTINGS).all()


@pytest.mark.slow
@settings(deadline=None)
@given(st.integers(1, 300), st.integers(1, 300), st.floats(0.05, 0.25))
def test_who_stands_for_long_counts_once(standing, again, spread):
    """People who watch from a place seen by two cameras are excluded, however long they stay."""
    rng = np.random.default_rng(standing)
    watching = 100.15 + spread * (rng.random((standing, 2)) - 0.5) / 2
    xy = np.concatenate([apart(20), watching])
    whole = np.repeat([4, 2], [20, standing])
    found = in_working_area(xy, covered(whole), 4, SETTINGS)
    np.testing.assert_array_equal(found, whole == 4)
    rows = rng.integers(0, len(xy), again)
    same = usual_place(xy, covered(whole), SETTINGS)
    twice = np.concatenate([xy, xy[rows]]), covered(np.append(whole, whole[rows]))
    assert usual_place(*twice, SETTINGS) == pytest.approx(same)


@pytest.mark.slow
def test_nobody_is_nowhere():
    assert within(np.zeros((0, 6))).shape == (0,)
