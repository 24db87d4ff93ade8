"""Who should be seen: occlusion, image borders, and detection rates."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.geometry._person import box_edges
from catfree.methods.evidence.observe._views import ground_views
from catfree.methods.evidence.observe._visibility import (
    ASPECT,
    Views,
    count_detections,
    expected_views,
    rate_of_counts,
    usual_heights,
)
from catfree.settings import EvidenceSettings
from catfree.settings._calibration_settings import FOOT_AHEAD
from tests.methods.evidence.evidence_worlds import HEIGHT, bare_boxes, make_rig, make_scene

RULES = EvidenceSettings()
CAMERAS = 4
VIEWS = ground_views(make_scene(make_rig(CAMERAS)), HEIGHT)

pytestmark = pytest.mark.usefixtures("x64")


def seen(state, member=None, box=None, frame=None, table=None):
    """Compute how all cameras see people at states (H, 3) among boxes of the same frame."""
    H = len(state)
    box = np.zeros((1, 4)) if box is None else box
    table = np.full((1, CAMERAS, 1), -1) if table is None else table
    unknown = np.zeros(len(box), int)
    boxes = bare_boxes(unknown, unknown, table, box=box)
    frame = np.zeros(H, int) if frame is None else frame
    found = expected_views(np.asarray(state, float), frame, boxes, VIEWS, RULES, member)
    return jax.tree.map(np.asarray, found)


def outline(state, camera):
    """Return the box (4,) of a person of usual width."""
    column, top, bottom = box_edges(VIEWS.matrix[camera], state, VIEWS.station[camera], FOOT_AHEAD)
    half = ASPECT / 2 * (bottom - top)
    return np.array([column - half, top, column + half, bottom])


near_the_middle = st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(0.8, 1.2))


@pytest.mark.slow
@given(near_the_middle)
def test_who_stands_alone_in_the_middle_is_seen_whole_by_everyone(state):
    found = seen([state])
    np.testing.assert_array_equal(found.cover, 0)
    np.testing.assert_allclose(found.share, 1)
    np.testing.assert_array_equal(found.inside, 1)
    tall = [outline(np.array(state), c) for c in range(CAMERAS)]
    np.testing.assert_allclose(found.height[0], [b[3] - b[1] for b in tall])


@pytest.mark.slow
@given(near_the_middle, st.floats(0.1, 0.8), st.integers(0, CAMERAS - 1))
def test_a_nearer_person_hides_in_that_camera_alone_and_never_oneself(state, ahead, camera):
    state = np.array(state)
    nearer = state.copy()
    nearer[:2] += (
        ahead
        * (VIEWS.station[camera] - state[:2])
        / np.linalg.norm(VIEWS.station[camera] - state[:2])
    )
    box = np.stack([outline(state, camera), outline(nearer, camera)])
    table = np.full((1, CAMERAS, 2), -1)
    table[0, camera] = [0, 1]
    member = np.full((2, CAMERAS), -1)
    member[:, camera] = [0, 1]
    found = seen([state, nearer], member, box, table=table)
    # The nearer box begins lower: only the part above its top is visible of the one behind.
    left = (box[1, 1] - box[0, 1]) / (box[0, 3] - box[0, 1])
    assert found.cover[0, camera] == pytest.approx(1 - left)
    assert found.cover[1, camera] == 0
    np.testing.assert_array_equal(np.delete(found.cover, camera, 1), 0)


@pytest.mark.slow
@given(st.floats(-6, 6), st.floats(-6, 6), st.floats(0.5, 1.5))
def test_the_share_in_the_picture_is_that_of_the_clipped_box(x, y, height):
    state = np.array([x, y, height])
    found = seen([state])
    for c in range(CAMERAS):
        foot, head = (VIEWS.matrix[c] @ [x, y, h, 1] for h in (0, height))
        if min(foot[2], head[2]) <= 0.05:
            continue
        box = outline(state, c)
        size = VIEWS.image_size[c]
        inside = [
            max(0.0, min(box[i + 2], size[i]) - max(box[i], 0.0)) / (box[i + 2] - box[i])
            for i in (0, 1)
        ]
        assert found.share[0, c] == pytest.approx(np.prod(inside), abs=1e-9)
        low, high = RULES.body_ramp
        ramp = (np.prod(inside) - low) / (high - low)
        assert found.inside[0, c] == pytest.approx(np.clip(ramp, 0, 1), abs=1e-9)


@pytest.mark.slow
@given(st.integers(0, 10**6), st.permutations(range(9)))
def test_everybody_is_seen_as_if_asked_alone_even_where_nothing_can_be_seen(seed, order):
    rng = np.random.default_rng(seed)
    order = np.array(order)
    state = np.column_stack([rng.uniform(-12, 12, (9, 2)), rng.uniform(0.1, 2, 9)])
    state[:2, :2] = VIEWS.station[:2]  # right under a camera
    state[2, :2] = 2 * VIEWS.station[0]  # behind it
    box = rng.uniform(0, 700, (6, 4))
    box[:, 2:] += box[:, :2]
    table = rng.integers(-1, 6, (2, CAMERAS, 3))
    frame = rng.integers(0, 2, 9)
    member = rng.integers(-1, 6, (9, CAMERAS))
    everyone = seen(state, member, box, frame, table)
    mixed = seen(state[order], member[order], box, frame[order], table)
    for all_, some in zip(jax.tree.leaves(everyone), jax.tree.leaves(mixed), strict=True):
        assert np.isfinite(all_).all()
        np.testing.assert_array_equal(all_[order], some)
    for name in ("inside", "cover", "share"):
        share = getattr(everyone, name)
        assert (share >= 0).all()
        assert (share <= 1 + 1e-12).all()  # a ratio of equal areas
    assert everyone.share[2, 0] == everyone.inside[2, 0] == 0


def _learned(views, member, heights):
    cameras = int((member >= 0).any(0).sum())
    counts = count_detections(views, member, heights, cameras, RULES)
    return rate_of_counts(heights, *counts, RULES)


def _in_full_view(shape):
    return Views(np.ones(shape), np.full(shape, 100.0), np.zeros(shape), np.ones(shape))


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.floats(0.2, 0.95), st.floats(0.2, 0.95))
def test_the_rate_of_a_camera_is_what_was_drawn_where_others_are_witnesses(seed, rate, usual):
    rng = np.random.default_rng(seed)
    H, C = 6000, 6
    drawn = np.array([rate] + [usual] * (C - 1))
    hit = rng.random((H, C)) < drawn
    # An equal number are false boxes of a single camera, which the others correctly miss.
    hit[H // 2 :] = np.eye(C, dtype=bool)[rng.integers(0, C, H // 2)]
    member = np.where(hit, np.arange(H * C).reshape(H, C), -1)
    shape = (H, C)
    views = _in_full_view(shape)
    size, camera = np.full(H * C, 100.0), np.tile(np.arange(C), H)
    trials = ((hit.sum(1, keepdims=True) - hit) >= 3).sum(0)
    found = _learned(views, member, usual_heights(size, camera, C, RULES))(views)
    # Four standard deviations of a share, plus the effect of the pseudo counts.
    pull = RULES.fewest_samples / (trials + RULES.fewest_samples)
    limit = 4 * np.sqrt(drawn * (1 - drawn) / trials) + pull
    assert (np.abs(found[0] - drawn) < limit).all()


@given(st.integers(0, 10**6))
def test_rates_are_probabilities_by_what_hides_and_nothing_outside_is_missed(seed):
    rng = np.random.default_rng(seed)
    H, C = 200, 5
    member = np.where(rng.random((H, C)) < rng.random(C), 0, -1)
    views = Views(
        rng.integers(0, 2, (H, C)).astype(float), rng.uniform(20, 400, (H, C)),
        rng.choice([0.0, 0.3, 0.5, 0.8, 1.0], (H, C)), np.ones((H, C)),
    )  # fmt: skip
    heights = usual_heights(rng.uniform(20, 400, 50), rng.integers(0, C, 50), C, RULES)
    found = _learned(views, member, heights)
    assert ((found.rate >= 0.01) & (found.rate <= 0.99)).all()
    assert found.rate.shape == (C, 3, len(RULES.cover_edges) + 1)
    np.testing.assert_array_equal(found(views)[np.asarray(views.inside) == 0], 0)


def test_nobody_seen_leaves_the_rate_that_was_assumed():
    empty = Views(*(np.zeros((0, 3)) for _ in range(4)))
    found = _learned(empty, np.zeros((0, 3), int), np.zeros((3, 2)))
    np.testing.assert_allclose(found.rate, RULES.detection_rate_start)


def test_a_dead_camera_says_nothing_about_the_others():
    def rates(member):
        return _learned(_in_full_view(member.shape), member, np.zeros((member.shape[1], 2))).rate

    member = np.tile([0, 0, 0, -1], (200, 1))
    np.testing.assert_array_equal(rates(member)[:3], rates(member[:, :3]))
    assert (rates(member)[3] < 0.1).all()


@pytest.mark.parametrize("cameras", [2, 3, 4])
def test_where_there_are_few_cameras_all_others_are_witnesses(cameras):
    rng = np.random.default_rng(cameras)
    rate, people = 0.5, 4000
    member = np.where(rng.random((people, cameras)) < rate, 0, -1)
    views = _in_full_view(member.shape)
    found = _learned(views, member, np.zeros((cameras, 2)))
    # The three others see one in eight: five deviations of a share of 500.
    np.testing.assert_allclose(found(views), rate, atol=0.11)
    np.testing.assert_allclose(found.usual, rate, atol=0.11)
