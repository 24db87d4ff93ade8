from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.synthetic._layouts import make_layout, ring
from catfree.synthetic._silhouettes import (
    NEAREST,
    ROWS,
    body_points,
    cast_silhouettes,
    project_points,
)
from catfree.synthetic._simulated_detector import DetectorModel, detect
from catfree.synthetic._walkers import Walkers, simulate_walkers

PERFECT = DetectorModel(
    detection_rate=1.0,
    half_visible=-10.0,
    half_height=-1000.0,
    persistence=0.0,
    box_noise=0.0,
    pixel_noise=0.0,
    false_positives=0.0,
    embedding_size=0,
)


def crowd(seed: int, people: int = 15, frames: int = 20):
    layout = make_layout("ring4", seed)
    return layout, simulate_walkers(
        layout.area, frames=frames, people=people, background=4, seed=seed
    )


def standing(positions, height: float = 1.7) -> Walkers:
    count = len(positions)
    return Walkers(
        position=np.asarray(positions, np.float64)[None],
        velocity=np.zeros((1, count, 2)),
        heading=np.zeros((1, count)),
        stride=np.zeros((1, count)),
        present=np.ones((1, count), bool),
        height=np.full(count, height),
        background=np.zeros(count, bool),
        group=np.arange(count),
        area=(-8.0, 8.0, -8.0, 8.0),
        fps=5.0,
    )


def along_the_view(distances) -> tuple:
    """Make a level rig and people one behind the other in front of its first camera."""
    layout = ring(2, seed=1)
    centre = layout.rig.centers[0]
    forward = layout.rig.R[0, 2, :2] / np.linalg.norm(layout.rig.R[0, 2, :2])
    return layout.rig, standing([centre[:2] + d * forward for d in distances])


@pytest.mark.slow
@given(seed=st.integers(0, 1000))
def test_boxes_contain_the_projected_people(seed):
    layout, walkers = crowd(seed, frames=5)
    seen = cast_silhouettes(walkers, layout.rig)
    for camera in range(layout.rig.camera_count):
        rows = seen.camera == camera
        pixel, depth = project_points(
            layout.rig,
            camera,
            body_points(walkers, seen.frame[rows], seen.person[rows]).reshape(-1, 3),
        )
        assert (depth > NEAREST).all()
        pixel = pixel.reshape(rows.sum(), -1, 2)
        box = seen.box[rows]
        assert (pixel >= box[:, None, :2] - 1e-9).all()
        assert (pixel <= box[:, None, 2:] + 1e-9).all()
        # The top of the head touches the top edge within the curvature of a skull.
        top = np.insert(
            walkers.position[seen.frame[rows], seen.person[rows]],
            2,
            walkers.height[seen.person[rows]],
            axis=1,
        )
        head, _ = project_points(layout.rig, camera, top)
        assert (np.abs(head[:, 1] - box[:, 1]) < 0.08 * (box[:, 3] - box[:, 1])).all()


@pytest.mark.slow
@given(seed=st.integers(0, 1000))
def test_a_perfect_detector_reports_every_body_inside_an_image(seed):
    layout, walkers = crowd(seed, frames=3)
    detections, identity = detect(walkers, layout.rig, model=PERFECT, seed=seed)
    seen = cast_silhouettes(walkers, layout.rig)
    size = layout.rig.image_size[seen.camera]
    extent = np.minimum(seen.box[:, 2:], size - 1) - np.maximum(seen.box[:, :2], 0)
    large = (extent[:, 0] > 2.0) & (extent[:, 1] > 8.0)
    expected = set(zip(seen.frame[large], seen.camera[large], seen.person[large], strict=True))
    got = set(zip(detections.frame, detections.camera, identity, strict=True))
    # A truncated box may be too small to report; an uncut one never is.
    assert got <= set(zip(seen.frame, seen.camera, seen.person, strict=True))
    whole = (seen.visible.mean(-1) > 0.99) & large
    assert set(zip(seen.frame[whole], seen.camera[whole], seen.person[whole], strict=True)) <= got
    assert len(got) > 0.95 * len(expected)


def test_nearer_people_hide_those_behind_and_not_the_reverse():
    rig, walkers = along_the_view([6.0, 6.8, 14.0])
    seen = cast_silhouettes(walkers, rig)
    first = seen.camera == 0
    share = dict(zip(seen.person[first], seen.visible[first].mean(-1), strict=True))
    hider = dict(zip(seen.person[first], seen.hidden_by[first], strict=True))
    assert share[0] == pytest.approx(1.0)
    assert share[1] < 0.7
    assert (hider[0], hider[1]) == (-1, 0)
    # From 4.5 m and above, a head stays visible over the one in front.
    rows = seen.visible[first & (seen.person == 1)][0]
    assert rows[0] > rows[ROWS // 2]


def test_columns_hide_people_behind_them_only():
    rig, walkers = along_the_view([6.0, 10.0])
    between = (walkers.position[0, 0] + walkers.position[0, 1]) / 2
    column = np.array([[*between, 0.4, 4.0]])
    free, blocked = cast_silhouettes(walkers, rig), cast_silhouettes(walkers, rig, column)
    for person, changes in ((0, False), (1, True)):
        row = (free.camera == 0) & (free.person == person)
        assert (blocked.visible[row].mean() < free.visible[row].mean() - 0.3) == changes


@pytest.mark.slow
def test_hidden_people_are_missed_more_often():
    layout, walkers = crowd(1, people=40, frames=60)
    model = replace(DetectorModel(), false_positives=0.0, embedding_size=0)
    detections, identity = detect(walkers, layout.rig, model=model, seed=1)
    seen = cast_silhouettes(walkers, layout.rig)
    got = set(zip(detections.frame, detections.camera, identity, strict=True))
    found = np.array([key in got for key in zip(seen.frame, seen.camera, seen.person, strict=True)])
    visible = seen.visible.mean(-1)
    rates = [
        found[(visible >= a) & (visible < b)].mean() for a, b in ((0, 0.2), (0.25, 0.45), (0.9, 2))
    ]
    assert rates[0] < 0.25
    assert rates[0] < rates[1] < rates[2]
    assert rates[2] > 0.93


def test_ankles_and_boxes_know_hidden_feet():
    layout, walkers = crowd(2, people=40, frames=40)
    model = replace(PERFECT, ankle_rate=1.0, false_ankle_rate=0.0, truncation=1.0)
    detections, identity = detect(walkers, layout.rig, model=model, seed=2)
    seen = cast_silhouettes(walkers, layout.rig)
    row = {key: i for i, key in enumerate(zip(seen.frame, seen.camera, seen.person, strict=True))}
    index = np.array(
        [row[key] for key in zip(detections.frame, detections.camera, identity, strict=True)]
    )
    confirmed = detections.ankles_confirmed
    feet = (seen.visible[index, -2:] >= 0.5).all(-1)
    np.testing.assert_array_equal(confirmed, feet)
    # Rays of feet below the border end at the border.
    bottom = np.minimum(seen.box[index, 3], layout.rig.image_size[0, 1] - 1)
    short = bottom - detections.box[:, 3]
    hidden = short / (seen.box[index, 3] - seen.box[index, 1])
    assert np.abs(short[confirmed]).max() < 1e-9
    assert np.median(hidden[~confirmed]) > 0.05


def test_appearance_is_strong_in_time_and_weak_across_views():
    layout, walkers = crowd(3, people=20, frames=40)
    detections, identity = detect(walkers, layout.rig, seed=3)
    rng = np.random.default_rng(0)
    a, b = rng.integers(len(detections), size=(2, 100_000))
    both = (identity[a] >= 0) & (identity[b] >= 0) & (a != b)
    a, b = a[both], b[both]
    np.testing.assert_allclose(np.linalg.norm(detections.embedding, axis=-1), 1, atol=1e-6)
    distance = 1 - np.einsum("nd,nd->n", detections.embedding[a], detections.embedding[b])
    same, view = identity[a] == identity[b], detections.camera[a] == detections.camera[b]
    in_time, across = np.median(distance[same & view]), np.median(distance[same & ~view])
    others = np.median(distance[~same & ~view])
    assert in_time < 0.2 < 0.3 < across < others - 0.1
    # Weak: some strangers look more alike than a typical person from two sides.
    assert np.quantile(distance[~same & ~view], 0.05) < np.quantile(distance[same & ~view], 0.95)


@pytest.mark.slow
def test_false_positives_come_at_the_stated_rate():
    layout, walkers = crowd(4, people=10, frames=200)
    for rate in (0.0, 0.5, 2.0):
        model = replace(DetectorModel(), false_positives=rate, embedding_size=0)
        detections, identity = detect(walkers, layout.rig, model=model, seed=4)
        frames_and_cameras = 200 * layout.rig.camera_count
        assert (identity < 0).sum() / frames_and_cameras == pytest.approx(rate, rel=0.15)
        if rate:
            false, real = detections.score[identity < 0], detections.score[identity >= 0]
            assert false.mean() < real.mean() - 0.2


def test_same_seed_same_detections():
    layout, walkers = crowd(5, frames=4)
    (first, who), (second, again) = (detect(walkers, layout.rig, seed=9) for _ in range(2))
    np.testing.assert_array_equal(who, again)
    for name, value in vars(first).items():
        if value is not None:
            np.testing.assert_array_equal(value, getattr(second, name))


def test_an_empty_world_gives_no_detections():
    layout = make_layout("ring4")
    nobody = simulate_walkers(layout.area, frames=3, people=0)
    detections, identity = detect(nobody, layout.rig)
    assert len(detections) == len(identity) == 0
