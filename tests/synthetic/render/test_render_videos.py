import os
from dataclasses import replace

import cv2
import numpy as np
import pytest

from catfree.errors import CatFreeError, InvalidInputError
from catfree.synthetic import make_world
from catfree.synthetic._layouts import shop
from catfree.synthetic._silhouettes import STRIDE_SHARE, cast_silhouettes, project_points
from catfree.synthetic.render import make_demo_world, render_videos, street_furniture
from catfree.synthetic.render._backdrop import render_background
from catfree.synthetic.render._bodies import FACES, SHIRT, TUBE, body_vertices
from catfree.synthetic.render._clothes import dress
from catfree.synthetic.render._painter import Painter
from catfree.synthetic.render._stage import build_stage
from catfree.synthetic.render._textures import ground_picture


@pytest.fixture(scope="module")
def world():
    return make_demo_world(2, cameras=2, people=8, frames=5, image_size=(640, 360))


@pytest.fixture(scope="module")
def stage(world):
    return build_stage(world, "hard")


@pytest.fixture(scope="module")
def backgrounds(world, stage):
    ground = ground_picture(stage)
    return [render_background(stage, world.true_rig, camera, ground) for camera in range(2)]


def painter(world, stage, backgrounds, camera, sunlight):
    # Without sunlight there are no shadows, so all changes in the picture are bodies.
    dim = replace(stage, sunlight=sunlight)
    artist = Painter(world.walkers, world.true_rig, camera, backgrounds[camera], dim)
    artist.noise = [artist.noise_middle] * len(artist.noise)
    return artist


def changes(painted, background):
    """Mark where a picture without noise differs from the background."""
    return np.abs(painted.astype(int) - background.picture).max(-1) > 4


@pytest.mark.slow
def test_bodies_appear_where_the_truth_projects(world, stage, backgrounds):
    seen = cast_silhouettes(world.walkers, world.true_rig, world.columns)
    checked = 0
    for camera in range(2):
        artist = painter(world, stage, backgrounds, camera, sunlight=0.0)
        for frame in (0, 4):
            mask = changes(artist.paint(frame), backgrounds[camera])
            boxes = seen.box[(seen.camera == camera) & (seen.frame == frame)]
            assert mask.sum() > 200
            outside = mask.copy()
            for x1, y1, x2, y2 in boxes:
                pad = 2 + 0.06 * (y2 - y1)
                columns = slice(max(int(x1 - pad), 0), int(x2 + pad) + 1)
                outside[max(int(y1 - pad), 0) : int(y2 + pad) + 1, columns] = False
            assert outside.sum() < 0.01 * mask.sum()
            alone = (seen.camera == camera) & (seen.frame == frame)
            alone &= seen.visible.mean(-1) > 0.99
            for x1, y1, x2, y2 in seen.box[alone]:
                others = (boxes[:, 0] < x2 + 6) & (boxes[:, 2] > x1 - 6)
                others &= (boxes[:, 1] < y2 + 6) & (boxes[:, 3] > y1 - 6)
                if others.sum() > 1 or x1 < 6 or y1 < 6 or x2 > 633 or y2 > 353:
                    continue
                left, top = int(x1) - 5, int(y1) - 5
                rows, columns = np.nonzero(mask[top : int(y2) + 6, left : int(x2) + 6])
                height = y2 - y1
                assert abs(rows.max() + top - y2) < 2 + 0.03 * height
                assert abs(rows.min() + top - y1) < 2 + 0.03 * height
                assert abs(columns.mean() + left - (x1 + x2) / 2) < 0.12 * height
                checked += 1
    assert checked >= 3


@pytest.mark.slow
def test_nobody_leaves_the_background(world, stage, backgrounds):
    nobody = replace(world.walkers, present=np.zeros_like(world.walkers.present))
    artist = painter(replace(world, walkers=nobody), stage, backgrounds, 0, sunlight=1.0)
    assert not changes(artist.paint(0), backgrounds[0]).any()


@pytest.mark.slow
def test_shadows_darken_the_ground_and_soft_ones_do_so_less(world, stage, backgrounds):
    camera, frame = 0, 2
    without = painter(world, stage, backgrounds, camera, sunlight=0.0).paint(frame)
    hard = Painter(world.walkers, world.true_rig, camera, backgrounds[camera], stage)
    cloudy = build_stage(world, "soft")
    soft = Painter(world.walkers, world.true_rig, camera, backgrounds[camera], cloudy)
    bodies = changes(without, backgrounds[camera])
    bodies = cv2.dilate(bodies.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    still = backgrounds[camera].picture.astype(int)
    hard_loss, soft_loss = ((still - each.paint(frame)).mean(-1) * ~bodies for each in (hard, soft))
    assert (hard_loss > 25).sum() > 100
    assert hard_loss[hard_loss > 25].mean() > 1.3 * soft_loss[hard_loss > 25].mean()


@pytest.mark.slow
def test_furniture_hides_who_stands_behind_it(world, stage, backgrounds):
    for camera in range(2):
        nearest = backgrounds[camera].distance
        assert np.isfinite(nearest).any()
        for x, y, radius, height in world.columns:
            foot, depth = project_points(world.true_rig, camera, np.array([x, y, height / 3]))
            column, row = np.round(foot).astype(int)
            if not (0 <= column < 640 and 0 <= row < 360) or height < 1:
                continue
            # The surface is a radius nearer than the axis; something else may be in front of it.
            to_axis = np.linalg.norm(world.true_centres[camera] - [x, y, height / 3])
            assert nearest[row, column] < to_axis - 0.7 * radius
            assert depth > 0


@pytest.mark.slow
def test_videos_are_complete_and_show_people(tmp_path):
    world = make_demo_world(3, cameras=2, people=5, frames=5, image_size=(320, 180))
    reports = []
    paths = render_videos(
        world, tmp_path / "new", lambda *report: reports.append(report), workers=1
    )
    assert [path.name for path in paths] == ["camera_0.mp4", "camera_1.mp4"]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [p.name for p in paths]
    assert reports == [("render", 5, 10), ("render", 10, 10)]
    seen = cast_silhouettes(world.walkers, world.true_rig, world.columns)
    for camera, path in enumerate(paths):
        video = cv2.VideoCapture(str(path))
        assert video.get(cv2.CAP_PROP_FPS) == world.layout.fps
        pictures = []
        while (read := video.read())[0]:
            pictures.append(read[1])
        assert len(pictures) == 5
        assert pictures[0].shape == (180, 320, 3)
        stage = build_stage(world)
        still = render_background(stage, world.true_rig, camera, ground_picture(stage)).picture
        difference = np.abs(pictures[4].astype(int) - still).mean(-1)
        inside = np.zeros(difference.shape, bool)
        rows = (seen.camera == camera) & (seen.frame == 4) & (seen.visible.mean(-1) > 0.8)
        for x1, y1, x2, y2 in np.clip(seen.box[rows], 0, None).astype(int):
            inside[y1 : y2 + 1, x1 : x2 + 1] = True
        assert inside.any()
        assert difference[inside].mean() > 3 * difference[~inside].mean()


@pytest.mark.slow
def test_processes_render_the_same_files(tmp_path):
    world = make_demo_world(4, cameras=2, people=3, frames=2, image_size=(160, 90))
    here = render_videos(world, tmp_path / "here", workers=1)
    reports = []
    there = render_videos(
        world, tmp_path / "there", lambda *report: reports.append(report), workers=2
    )
    assert [path.read_bytes() for path in here] == [path.read_bytes() for path in there]
    assert reports[-1] == ("render", 4, 4)


def test_bodies_are_closed_upright_and_as_tall_as_told():
    stride = np.linspace(0, 2 * np.pi, 9)
    for speed in (0.0, 1.4):
        vertices = body_vertices(stride, np.full(9, speed))
        assert vertices.shape == (9, len(TUBE), 3)
        assert FACES.max() == len(TUBE) - 1
        np.testing.assert_allclose(vertices[..., 2].max(1), 1.0, atol=1e-9)
        assert (vertices[..., 2].min(1) > -0.01).all()
        # Faces look outwards: away from the axis of their own tube.
        face = vertices[:, FACES]
        normal = np.cross(face[:, :, 2] - face[:, :, 0], face[:, :, 3] - face[:, :, 1])
        centre = face.mean(2)
        tube = TUBE[FACES[:, 0]]
        middle = np.stack([centre[:, tube == i].mean(1) for i in range(tube.max() + 1)], 1)
        outward = np.einsum("nfi,nfi->nf", normal, centre - middle[:, tube])
        assert (outward > 0).mean() > 0.93


def test_legs_walk():
    quarter = body_vertices(np.array([np.pi / 2]), np.array([1.4]))[0]
    still = body_vertices(np.array([np.pi / 2]), np.array([0.0]))[0]
    reach = [quarter[tube == TUBE, 1].mean() for tube in (2, 3)]
    assert abs(reach[0] - reach[1]) == pytest.approx(2 * STRIDE_SHARE, abs=1e-9)
    together = [still[tube == TUBE, 1].mean() for tube in (2, 3)]
    assert together[0] == pytest.approx(together[1])


def test_clothes_are_seeded_and_differ():
    first, bags = dress(20, 1)
    again, _ = dress(20, 1)
    np.testing.assert_array_equal(first, again)
    assert 0 < bags.sum() < 20
    shirts = first[:13, SHIRT]
    gaps = np.linalg.norm(shirts[:, None] - shirts[None], axis=-1) + np.eye(13)
    assert gaps.min() > 0.05


def test_furniture_stands_inside_and_apart():
    area = (-8.0, 8.0, -8.0, 8.0)
    for seed in range(5):
        columns = street_furniture(area, seed)
        np.testing.assert_array_equal(columns, street_furniture(area, seed))
        assert columns.shape == (7, 4)
        assert (np.abs(columns[:, :2]) < 8).all()
        gap = np.linalg.norm(columns[:, None, :2] - columns[None, :, :2], axis=-1)
        gap = gap - columns[:, None, 2] - columns[None, :, 2] + 99 * np.eye(7)
        assert gap.min() > 1.0


def test_wrong_requests_are_refused(world, tmp_path):
    with pytest.raises(InvalidInputError, match="workers"):
        render_videos(world, tmp_path, workers=0)
    with pytest.raises(InvalidInputError, match="shadows"):
        render_videos(world, tmp_path, shadows="none")
    with pytest.raises(InvalidInputError, match="without lens distortion"):
        render_videos(make_world(shop(), frames=1, people=1), tmp_path / "bent")
    assert not (tmp_path / "bent").exists()


@pytest.mark.slow
def test_an_interruption_leaves_out_the_cameras_that_have_not_begun(tmp_path):
    world = make_demo_world(cameras=8, people=1, frames=20, image_size=(160, 96))

    def interrupted(*report):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_videos(world, tmp_path, interrupted, workers=2)
    assert len(list(tmp_path.glob("*.mp4"))) < 8


# Runs at Python's start: Ctrl-C arrives while OpenCV is imported.
AT_IMPORT = """
import signal, sys

class Interruption:
    def find_spec(self, name, path, target=None):
        if name == "cv2":
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Interruption())
"""


@pytest.mark.slow
def test_an_interruption_ends_a_worker_that_is_importing_without_a_word(
    tmp_path, monkeypatch, capfd
):
    (tmp_path / "sitecustomize.py").write_text(AT_IMPORT)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    with pytest.raises(CatFreeError, match="ended early"):
        render_videos(make_world("ring3", frames=2, people=1), tmp_path / "videos", workers=2)
    assert capfd.readouterr().err == ""
