"""Which instants the page plays, and where its pictures are."""

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.adapters import SynchronizedVideos
from catfree.viz.page._excerpt import (
    MOST_INSTANTS,
    MOST_PICTURES,
    MOST_POSITIONS,
    Excerpt,
    arrange,
    choose_excerpt,
    write_pictures,
)
from catfree.viz.page._player import make_player, player_markup


@given(
    instants=st.integers(0, 3000),
    cameras=st.integers(1, 40),
    rate=st.sampled_from([None, 1.0, 5.0, 12.0, 25.0]),
    pictured=st.booleans(),
    seed=st.integers(0, 99),
)
def test_an_excerpt_is_short_even_and_where_most_people_are(
    instants, cameras, rate, pictured, seed
):
    rng = np.random.default_rng(seed)
    frames = 7 + 2 * np.arange(instants)
    tracked = rng.choice(frames, 400) if instants else np.zeros(0, int)
    excerpt = choose_excerpt(frames, tracked, cameras, rate, pictured=pictured)
    chosen = excerpt.frames
    assert set(chosen) <= set(frames)
    assert excerpt.total == instants
    assert len(set(np.diff(chosen))) <= 1
    if not instants:
        assert len(chosen) == 0
        return
    assert 1 <= len(chosen) <= (max(MOST_PICTURES // cameras, 2) if pictured else MOST_INSTANTS)
    stride = int(chosen[1] - chosen[0]) // 2 if len(chosen) > 1 else 1
    if len(chosen) > 1:
        assert excerpt.rate == pytest.approx((rate or 5.0) / stride)
        assert excerpt.rate <= 8 or not pictured
    length = (chosen[-1] - chosen[0]) // 2 + 1
    held = ((tracked >= chosen[0]) & (tracked <= chosen[-1])).sum()
    for start in rng.integers(0, max(instants - length, 0) + 1, 5):
        window = frames[start : start + length]
        assert held >= ((tracked >= window[0]) & (tracked <= window[-1])).sum() - stride * 40


def test_a_crowd_makes_an_excerpt_shorter():
    frames = np.arange(100)
    crowd = np.repeat(frames, MOST_POSITIONS // 50)
    assert len(choose_excerpt(frames, crowd, 4, 5.0, pictured=False).frames) == 50


@pytest.mark.slow
@given(
    sizes=st.lists(st.tuples(st.integers(64, 4000), st.integers(64, 4000)), min_size=1, max_size=40)
)
def test_tiles_keep_their_shape_and_do_not_overlap(sizes):
    board = arrange(np.array(sizes))
    taken = np.zeros(board.size[::-1], int)
    for (x, y, width, height), (w, h) in zip(board.tiles, sizes, strict=True):
        assert abs(width / w - height / h) <= 1 / min(w, h)
        assert x + width <= board.size[0]
        assert y + height <= board.size[1]
        taken[y : y + height, x : x + width] += 1
    assert taken.max() == 1


@pytest.mark.slow
def test_pictures_of_an_earlier_run_go(world, localization, tmp_path):
    folders = []
    for camera in range(4):
        folders.append(tmp_path / str(camera))
        folders[-1].mkdir()
        for frame in range(6):
            size = tuple(int(side) for side in world.scene.rig.image_size[0])
            cv2.imwrite(str(folders[-1] / f"{frame}.jpg"), np.full((*size[::-1], 3), 99, np.uint8))
    videos, results = SynchronizedVideos(folders), (world.detections, localization, world.scene)
    out = tmp_path / "out"
    first = write_pictures(out, videos, Excerpt(np.arange(6), 5.0, 6), *results)
    assert [path.name for path in first] == [f"{frame:06d}.jpg" for frame in range(6)]
    second = write_pictures(out, videos, Excerpt(np.array([1, 3]), 5.0, 6), *results, blur=True)
    assert sorted(out.iterdir()) == second
    assert cv2.imread(str(second[0])).shape[:2] == arrange(videos.image_size).size[::-1]
    assert write_pictures(out, videos, Excerpt(np.arange(0), 5.0, 6), *results) == []


@pytest.mark.slow
def test_the_data_are_those_of_the_excerpt(world, localization):
    excerpt = Excerpt(np.array([2, 5, 6]), 5.0, 12)
    lost = dataclasses.replace(world.scene.rig, registered=np.array([True, False, True, True]))
    scene = dataclasses.replace(world.scene, rig=lost)
    names = ("</script>", "b", "c", "d")
    player = make_player(excerpt, world.detections, localization, scene, names)
    people, boxes = player.data["people"], player.data["boxes"]
    for at, frame in enumerate(excerpt.frames):
        rows = slice(people["start"][at], people["start"][at + 1])
        now = localization.tracks[localization.tracks.frame == frame]
        assert people["id"][rows] == now.track_id.tolist()
        np.testing.assert_allclose(people["x"][rows], now.ground_xy[:, 0], rtol=1e-3, atol=1e-3)
        here = slice(boxes["start"][at], boxes["start"][at + 1])
        seen = np.flatnonzero(world.detections.frame == frame)
        assert boxes["camera"][here] == world.detections.camera[seen].tolist()
        assert boxes["id"][here] == localization.identity[seen].tolist()
    assert len(boxes["box"]) == 4 * boxes["start"][-1]
    assert [camera["wedge"] is None for camera in player.data["cameras"]] == [False, True] + [
        False
    ] * 2
    assert player_markup(player).count("</script>") == 2
    assert "3 of 12 instants (frames 2 to 6)" in player.caption
