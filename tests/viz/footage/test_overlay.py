import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree.errors import InvalidInputError
from catfree.geometry import transform_scene
from catfree.geometry._plane import from_plan
from catfree.geometry.camera import pixels_of_points, rays_of_pixels
from catfree.types import Rig, Scene
from catfree.viz import draw_frame, draw_ground_grid, write_overlay_video
from catfree.viz._palette import UNTRACKED, track_color
from catfree.viz._person_height import person_height
from catfree.viz.footage._drawing import (
    draw_label,
    draw_polyline,
    fill_polygon,
    round_step,
    text_size,
    visible_runs,
)
from catfree.viz.footage._ground_grid import ground_grid
from catfree.viz.footage._plan_canvas import PlanCanvas

SIZE = (192, 108)
GREY = np.full((1080, 1920, 3), 128, np.uint8)


@pytest.fixture
def small(world):
    """Return the world's scene and boxes at a tenth of the picture size."""
    rig = world.scene.rig
    K = np.asarray(rig.K) * np.array([[0.1], [0.1], [1.0]])
    scene = Scene(Rig(K, rig.R, rig.t, SIZE), world.scene.ground, world.scene.extent)
    seen = world.detections
    return cf.Detections(seen.frame, seen.camera, seen.box / 10), scene


@pytest.fixture
def videos(tmp_path):
    """Write four gray videos of six frames."""
    paths = []
    for camera in range(4):
        paths.append(tmp_path / f"camera_{camera}.mp4")
        writer = cv2.VideoWriter(str(paths[-1]), cv2.VideoWriter.fourcc(*"mp4v"), 5.0, SIZE)
        for _ in range(6):
            writer.write(np.full((SIZE[1], SIZE[0], 3), 128, np.uint8))
        writer.release()
    return paths


def read_video(path):
    capture = cv2.VideoCapture(str(path))
    frames = []
    while True:
        ok, frame = capture.read()
        if not ok:
            break
        frames.append(frame)
    rate = capture.get(cv2.CAP_PROP_FPS)
    capture.release()
    return frames, rate


@pytest.mark.slow
def test_the_video_has_one_frame_an_instant_and_the_asked_size(
    small, localization, videos, tmp_path
):
    detections, scene = small
    reports = []
    path = write_overlay_video(
        tmp_path / "overlay.mp4",
        videos,
        detections,
        localization,
        scene,
        width=640,
        progress=lambda *report: reports.append(report),
    )
    frames, rate = read_video(path)
    assert len(frames) == 6
    assert rate == pytest.approx(5.0)
    assert all(frame.shape == frames[0].shape for frame in frames)
    assert frames[0].shape[1] == 640
    assert frames[0].shape[0] % 2 == 0
    assert reports[-1] == ("overlay", 6, 6)
    # People are drawn: there is color in the gray pictures, and the view from above is light.
    tiles = frames[3][:, :400].astype(int)
    assert (np.ptp(tiles, axis=-1) > 60).sum() > 50
    assert np.median(frames[3][:, 460:]) > 200
    assert [one.name for one in tmp_path.iterdir() if "partial" in one.name] == []


@pytest.mark.slow
def test_webm_is_vp8_and_says_nothing_on_the_terminal(small, localization, videos, tmp_path, capfd):
    detections, scene = small
    path = tmp_path / "overlay.webm"
    write_overlay_video(path, videos, detections, localization, scene, width=320, blur=True)
    assert capfd.readouterr() == ("", "")
    assert len(read_video(path)[0]) == 6
    capture = cv2.VideoCapture(str(path))
    assert int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == b"VP80"
    capture.release()
    with pytest.raises(InvalidInputError, match=r"overlay\.avi must end in one of"):
        write_overlay_video(
            path.with_suffix(".avi"), videos, detections, localization, scene, width=320
        )


@pytest.mark.slow
def test_a_wrong_number_of_videos_is_named_and_leaves_no_file(
    small, localization, videos, tmp_path
):
    detections, scene = small
    target = tmp_path / "overlay.mp4"
    with pytest.raises(InvalidInputError, match="3 videos for 4 cameras"):
        write_overlay_video(target, videos[:3], detections, localization, scene)
    with pytest.raises(InvalidInputError, match="Cannot write"):
        write_overlay_video(
            tmp_path / "missing" / "overlay.mp4", videos, detections, localization, scene
        )
    assert not target.exists()


@pytest.mark.slow
def test_a_picture_of_another_size_is_refused(world, localization):
    with pytest.raises(InvalidInputError, match="camera 1 is 640 x 360 px"):
        draw_frame(
            np.zeros((360, 640, 3), np.uint8), 1, 0, world.detections, localization, world.scene
        )


@pytest.mark.slow
def test_posts_stand_where_the_tracks_project(world, localization):
    frame = int(np.median(localization.tracks.frame))
    now = localization.tracks[localization.tracks.frame == frame]
    nobody = world.detections[:0]
    drawn = draw_frame(GREY, 2, frame, nobody, localization, world.scene, person_height=0.05)
    assert (GREY == 128).all()
    up, checked = np.asarray(world.scene.ground.normal), 0
    for position, identity in zip(now.position, now.track_id, strict=True):
        middle = position + 0.025 * up
        pixel, in_front = pixels_of_points(world.scene.rig, 2, middle[None])
        x, y = np.round(pixel[0]).astype(int)
        if in_front[0] and 5 < x < 1915 and 5 < y < 1075:
            around = drawn[y - 2 : y + 3, x - 3 : x + 4].reshape(-1, 3)
            assert (around == track_color(identity)).all(-1).any()
            checked += 1
    assert checked >= 2


@pytest.mark.slow
def test_boxes_have_the_colour_of_their_track_or_grey(world, localization):
    frame = int(np.median(localization.tracks.frame))
    rows = np.flatnonzero((world.detections.frame == frame) & (world.detections.camera == 0))
    now = localization.tracks[localization.tracks.frame == frame]
    shown = (now.support[:, 0][:, None] == rows) & (rows >= 0)  # (track row, box)
    drawn = draw_frame(GREY, 0, frame, world.detections, localization, world.scene, person_height=0)
    assert shown.any()
    for of_box, box in zip(shown.T, world.detections.box[rows], strict=True):
        color = track_color(int(now.track_id[of_box.argmax()])) if of_box.any() else UNTRACKED
        x1, y1 = np.round(box[:2]).astype(int)
        corner = drawn[max(y1 - 2, 0) : y1 + 3, max(x1 - 2, 0) : x1 + 3].reshape(-1, 3)
        if len(corner):
            assert (np.abs(corner.astype(int) - color).max(-1) < 40).any()


@pytest.mark.slow
def test_boxes_of_another_run_are_refused(world, localization):
    fewer = world.detections[:-1]
    with pytest.raises(InvalidInputError, match="was made from"):
        draw_frame(GREY, 0, 0, fewer, localization, world.scene)
    with pytest.raises(InvalidInputError, match="was made from"):
        person_height(fewer, localization, world.scene)


@pytest.mark.slow
def test_person_height_is_that_of_the_people_in_any_unit(world, localization):
    metric = transform_scene(world.scene_from_world.inverse(), world.scene, metric=True)
    in_units = person_height(world.detections, localization, world.scene)
    scale = float(world.scene_from_world.scale)
    assert in_units / scale == pytest.approx(np.median(world.walkers.height), abs=0.15)
    found = cf.localize(world.detections, metric, cf.Settings.paper())
    assert person_height(world.detections, found, metric) == pytest.approx(
        in_units / scale, rel=1e-2
    )
    assert person_height(world.detections[:0], localization, world.scene) == 0


@pytest.mark.slow
def test_unregistered_cameras_show_boxes_only(world, localization):
    rig = world.scene.rig
    known = np.array([True, True, False, True])
    lost = Scene(
        Rig(rig.K, rig.R, rig.t, rig.image_size, registered=known),
        world.scene.ground,
        world.scene.extent,
    )
    drawn = draw_frame(GREY, 2, 5, world.detections, localization, lost)
    colors = {tuple(color) for color in drawn.reshape(-1, 3)[::7].tolist()}
    assert all(max(color) - min(color) == 0 for color in colors)
    with pytest.raises(InvalidInputError, match="not a registered camera"):
        draw_ground_grid(GREY, lost, 2)


@pytest.mark.parametrize("image", [GREY / 255, GREY[..., 0], GREY[..., :1]])
def test_images_other_than_rgb_bytes_are_refused(image, world):
    scene = world.true_scene
    with pytest.raises(InvalidInputError, match=r"must be a non-empty .* uint8 RGB array"):
        draw_ground_grid.__wrapped__(image, scene, 1)
    with pytest.raises(InvalidInputError, match=r"must be a non-empty .* uint8 RGB array"):
        draw_frame.__wrapped__(image, 1, 0, world.detections, None, scene)


@pytest.mark.slow
def test_what_cannot_be_drawn_is_named(world, localization):
    draw, draw_grid = draw_frame.__wrapped__, draw_ground_grid.__wrapped__
    boxes, scene = world.detections, world.scene
    for use, message in (
        (lambda: draw_grid(GREY, scene, 9), "camera is 9, but the rig has 4 cameras"),
        (lambda: draw_grid(GREY, scene, "C1"), "camera must hold whole numbers"),
        (lambda: draw_grid(GREY, scene.rig, 0), "scene must be a Scene, got Rig"),
        (lambda: draw(GREY, 9, 0, boxes, localization, scene), "camera is 9, but the rig has 4"),
        (lambda: draw(GREY, -1, 0, boxes, localization, scene), "camera is -1; indices start"),
        (lambda: draw(GREY, 0, 0.5, boxes, localization, scene), "frame is 0.5"),
        (lambda: draw(GREY, 0, 0, None, localization, scene), "detections must be a Detections"),
        (lambda: draw(GREY, 0, 0, boxes, None, scene), "localization must be a Localization"),
        (lambda: draw(GREY, 0, 0, boxes, localization, None), "scene must be a Scene"),
        (lambda: draw(GREY, 0, 0, boxes, localization, scene, stroke=np.nan), "stroke is nan"),
        (
            lambda: draw(GREY, 0, 0, boxes, localization, scene, stroke=len(GREY) + 1),
            f"stroke is {len(GREY) + 1}; lines can be at most",
        ),
        (
            lambda: draw(GREY, 0, 0, boxes, localization, scene, person_height="tall"),
            "person_height is 'tall'; it must be a finite number",
        ),
    ):
        with pytest.raises(InvalidInputError, match=message):
            use()


@pytest.mark.parametrize(
    ("area", "spacing"), [(None, 1e-9), ((-1e9, 1e9, -1e9, 1e9), None), ((0, 1, 0, 1), 1 / 501)]
)
def test_too_many_grid_lines_are_refused(world, area, spacing):
    with pytest.raises(InvalidInputError, match=r"lines at a spacing of .*; draw at most 1000"):
        draw_ground_grid(GREY, world.true_scene, 1, area=area, spacing=spacing)


def test_grid_lines_project_where_opencv_says(world):
    scene = world.true_scene
    drawn = draw_ground_grid(GREY, scene, 1, area=world.area, spacing=1.0)
    assert drawn.shape == GREY.shape
    assert (GREY == 128).all()
    lines = ground_grid(world.area, 1.0)
    assert len(lines) == 17 + 17
    rig = scene.rig
    rotation = cv2.Rodrigues(rig.R[1])[0]
    hits = total = 0
    for axis, index, points in lines:
        constant = points[:, "xy".index(axis)]
        np.testing.assert_allclose(constant, index)
        world_points = from_plan(scene, points)
        pixel = cv2.projectPoints(world_points, rotation, rig.t[1], rig.K[1], None)[0][:, 0]
        depth = world_points @ rig.R[1, 2] + rig.t[1, 2]
        for x, y in pixel[depth > 1.0].round().astype(int):
            if 2 <= x < 1918 and 2 <= y < 1078:
                hits += (drawn[y - 1 : y + 2, x - 1 : x + 2] != 128).any()
                total += 1
    assert total > 500
    assert hits == total


@pytest.mark.slow
@given(seed=st.integers(0, 1000))
def test_pixels_and_rays_are_inverse(world, seed):
    rig = world.scene.rig
    pixel = np.random.default_rng(seed).uniform([0, 0], [1919, 1079], (300, 2))
    rays = rays_of_pixels(rig, 1, pixel)
    again, in_front = pixels_of_points(rig, 1, np.asarray(rig.centers)[1] + 0.3 * rays)
    assert in_front.all()
    np.testing.assert_allclose(again, pixel, atol=0.05)
    assert not pixels_of_points(rig, 1, np.asarray(rig.centers)[1] - 0.3 * rays)[1].any()


def test_runs_end_behind_the_camera_and_far_outside():
    pixel = np.array([[5.0, 5], [6, 6], [7, 7], [8, 8], [1e6, 9], [10, 10], [11, 11], [12, 12]])
    front = np.array([True, True, True, False, True, True, True, True])
    runs = visible_runs(pixel, front, (100, 100))
    assert [len(run) for run in runs] == [3, 3]
    np.testing.assert_array_equal(runs[1], pixel[5:])


@given(length=st.floats(1e-6, 1e6))
def test_round_steps(length):
    step = round_step(length)
    assert step <= length * (1 + 1e-6)
    assert length < 2.5 * step * (1 + 1e-6)
    mantissa = step / 10 ** np.floor(np.log10(step) + 1e-9)
    assert min(abs(mantissa - np.array([1, 2, 5]))) < 1e-6


def test_drawing_at_and_beyond_the_border_changes_only_what_it_should():
    picture = np.zeros((40, 60, 3), np.uint8)
    fill_polygon(
        picture, np.array([[100.0, 100.0], [120.0, 100.0], [110.0, 120.0]]), (255, 0, 0), 0.5
    )
    assert (picture == 0).all()
    fill_polygon(
        picture, np.array([[-10.0, -10.0], [20.0, -10.0], [-10.0, 20.0]]), (200, 0, 0), 0.5
    )
    assert picture[0, 0].tolist() == [100, 0, 0]
    assert (picture[:, 30:] == 0).all()
    draw_polyline(picture, np.array([[30.0, 35.0], [70.0, 35.0]]), (0, 255, 0), 1.0)
    assert picture[35, 45, 1] > 200
    width, height = text_size("7", 1.0)
    draw_label(picture, "7", (40.0, 2.0), (0, 0, 255), 1.0)
    assert (picture[2 : 2 + height, 40 : 40 + width, 2] > 0).all()


@pytest.mark.slow
def test_the_plan_puts_ground_coordinates_upright(world, localization):
    view = (-10.0, 10.0, -5.0, 15.0)
    plan = PlanCanvas(world.true_scene, view, (400, 200), ["a", "b", "c", "d"])
    np.testing.assert_allclose(plan.to_pixels(np.array([0.0, 5.0])), [200, 100])
    right, up = plan.to_pixels(np.array([[1.0, 5.0], [0.0, 6.0]])) - [200, 100]
    np.testing.assert_allclose([right, up], [[10, 0], [0, -10]])
    tracks = localization.tracks
    now = tracks[tracks.frame == tracks.frame[-1]]
    first = plan.draw(now, tracks)
    again = plan.draw(now, tracks)
    np.testing.assert_array_equal(first, again)
    blank = plan.draw(now[:0], tracks[:0])
    assert (blank != first).any()
