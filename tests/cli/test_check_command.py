"""`check` on files of boxes: a table and a page."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from catfree import cli
from catfree.adapters import write_scene_json
from catfree.calibration import CameraCheck, Check, Verdict
from catfree.cli._check_command import NAMED
from catfree.synthetic import make_layout, make_world
from catfree.types import Clock, Detections
from tests.calibration.watching.bumped import on_clock, turn_camera

pytest.importorskip("tyro")


@pytest.mark.slow
def test_a_turned_camera_is_named_in_the_table_and_on_the_page(tmp_path, capsys):
    world = make_world("ring4", seed=2, frames=100, people=8)
    turn = np.deg2rad([0.0, 3.0, 0.0])
    boxes = turn_camera(on_clock(world.detections, 5.0), world.true_rig, 1, turn, 60)
    boxes.save(tmp_path / "boxes.npz")
    write_scene_json(tmp_path / "scene.json", world.true_scene)
    out = tmp_path / "page"
    words = ["check", str(tmp_path / "boxes.npz"), "--scene", str(tmp_path / "scene.json")]
    assert cli.main([*words, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "moved" in printed
    page = (out / "report.md").read_text()
    assert page.count("| pass | C") == 3
    assert "| check | C2 moved | Turned by" in page
    assert "MODA is expected" in page
    assert (out / "report.html").is_file()
    assert (out / "coverage.png").is_file()
    assert "(ground_grid.jpg)" in page
    assert cv2.imread(str(out / "ground_grid.jpg")).std() > 5

    # With videos the grid lies on their pictures.
    folders = []
    for camera, (width, height) in enumerate(world.true_rig.image_size.tolist()):
        folders.append(tmp_path / f"video {camera}")
        folders[-1].mkdir()
        for frame in range(3):
            picture = np.full((height, width, 3), (0, 0, 200), np.uint8)
            cv2.imwrite(str(folders[-1] / f"{frame}.png"), picture)
    few = [*words, "--out", str(out), "--videos", *map(str, folders)]
    assert cli.main(few) == 0
    blue, green, red = cv2.imread(str(out / "ground_grid.jpg")).reshape(-1, 3).T
    assert np.median(red) > 150 > 60 > np.median(blue)
    assert (green > 150).any()
    assert cli.main(few[:-1]) == 1
    assert "There are 3 videos for 4 cameras" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1])
def test_people_on_the_page_can_be_made_unrecognizable(first, tmp_path, capsys):
    world = make_world("ring4", seed=2, frames=12, people=8)
    boxes = Detections(**(vars(world.detections) | {"frame": world.detections.frame + first}))
    boxes.save(tmp_path / "boxes.npz")
    write_scene_json(tmp_path / "scene.json", world.true_scene)
    folders, pictures = [], np.random.default_rng(0)
    for camera, (width, height) in enumerate(world.true_rig.image_size.tolist()):
        folders.append(tmp_path / f"video {camera}")
        folders[-1].mkdir()
        for frame in range(15):
            picture = pictures.integers(0, 255, (height, width, 3), np.uint8)
            cv2.imwrite(str(folders[-1] / f"{frame}.png"), picture)
    words = ["check", str(tmp_path / "boxes.npz"), "--scene", str(tmp_path / "scene.json")]
    words += ["--out", str(tmp_path / "page"), "--videos", *map(str, folders)]
    shown = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "catfree.viz.footage._ground_grid.draw_ground_grids",
            lambda images, scene: shown.append(images) or images,
        )
        assert cli.main(words) == cli.main([*words, "--blur"]) == 0
    last = world.detections[world.detections.frame == 11]
    for camera in range(4):
        plain, blurred = (images[camera] for images in shown)
        size = np.tile(world.true_rig.image_size[camera], 2)
        for box in last.box[last.camera == camera]:
            x1, y1, x2, y2 = np.clip(box, 0, size).astype(int)
            if x2 - x1 > 20 and y2 - y1 > 20:
                part = np.s_[y1:y2, x1:x2]
                assert blurred[part].std() < 0.5 * plain[part].std()
    capsys.readouterr()
    moved = Detections(**(vars(world.detections) | {"frame": world.detections.frame + 100}))
    moved.save(tmp_path / "boxes.npz")
    assert cli.main([*words, "--blur"]) == 1
    assert "are not those of the videos" in capsys.readouterr().err


def _judged(camera, verdict, advice):
    numbers = dict.fromkeys(("degrees", "degrees_sd", "pixels", "ground", "lag", "lag_sd"), 0.0)
    turn = {"turn": np.zeros(3), "turn_covariance": np.eye(3), "matched": 1.0}
    return CameraCheck(camera, verdict, None, None, advice=advice, **numbers, **turn)


def test_a_camera_that_fits_refers_to_the_warning_that_names_it(tmp_path, monkeypatch, capsys):
    fits, moved = (Verdict.FITS, "Nothing to do."), (Verdict.MOVED, "Calibrate again.")
    verdicts = (fits, fits, moved)
    cameras = tuple(_judged(camera, *found) for camera, found in enumerate(verdicts))
    outcome = SimpleNamespace(
        scene=None, detections=None, localization=None, camera_names=("C1", "C10", "C2"),
        warnings=("Camera 'C10' is late.", "Camera 'C2' has a wrong lens."),
    )  # fmt: skip
    Detections([0], [0], [[0.0, 0, 10, 30]]).save(tmp_path / "boxes.npz")
    write_scene_json(tmp_path / "scene.json", make_layout("ring4", 0).scene)
    monkeypatch.setattr("catfree._run._run.run_stages", lambda *args, **options: outcome)
    result = Check(cameras, 0, 3, 1.0, True)
    monkeypatch.setattr("catfree.check", lambda *args, **options: result)
    words = ["check", str(tmp_path / "boxes.npz"), "--scene", str(tmp_path / "scene.json")]
    assert cli.main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3:] == ["C1: Nothing to do.", f"C10: {NAMED}", "C2: Calibrate again."]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--since", "99"], "since is frame 99, but the boxes are of frames"),
        (["--videos", "a.mp4", "b.mp4"], "--videos and --blur are for the page"),
        (["--blur"], "--videos and --blur are for the page"),
        (["--offsets", "1", "2"], "--offsets apply to --videos"),
        (["--silent", "none.csv"], "none.csv"),
    ],
)
def test_words_that_do_not_fit_are_told_before_the_long_work(
    words, sentence, tmp_path, monkeypatch, capsys
):
    world = make_world("ring4", seed=2, frames=4, people=2)
    world.detections.save(tmp_path / "boxes.npz")
    write_scene_json(tmp_path / "scene.json", world.true_scene)
    monkeypatch.setattr("catfree._run._run.run_stages", None)
    boxes, scene = (str(tmp_path / name) for name in ("boxes.npz", "scene.json"))
    assert cli.main(["check", boxes, "--scene", scene, *words]) == 1
    assert sentence in capsys.readouterr().err


@pytest.fixture
def pages(monkeypatch):
    """Record the footage and boxes of each written page, computing nothing."""
    pages = []
    monkeypatch.setattr(
        "catfree._run._run.run_stages",
        lambda boxes, *args, **options: SimpleNamespace(
            scene=None, detections=None, localization=None, camera_names=boxes.camera_names,
            warnings=(), silent=boxes.silent,
        ),
    )  # fmt: skip

    def judge(*args, camera_names, **options):
        cameras = (_judged(at, Verdict.FITS, "") for at in range(len(camera_names)))
        return Check(tuple(cameras), 0, 1, 1.0, True)

    monkeypatch.setattr("catfree.check", judge)
    monkeypatch.setattr(
        "catfree.cli._check_command.write_check_page",
        lambda out, result, outcome, footage, **options: pages.append((footage, outcome)),
    )
    return pages


def write_still_pictures(folder, names, frames):
    """Write a folder of gray images per camera, each with its number as gray level."""
    folders = []
    for name in names:
        folders.append(folder / name)
        folders[-1].mkdir(parents=True)
        for frame in range(frames):
            picture = np.full((8, 8, 3), frame, np.uint8)
            cv2.imwrite(str(folders[-1] / f"{frame:02d}.png"), picture)
    return folders


@pytest.mark.parametrize("seen", ["abcd", "dbca", "db"])
def test_each_video_is_that_of_the_camera_with_its_boxes(seen, tmp_path, pages, capsys):
    """The scene takes the order of the boxes, without cameras that have none."""
    write_scene_json(tmp_path / "scene.json", make_layout("ring4", 0).scene, list("abcd"))
    files = [tmp_path / f"{name}.txt" for name in seen]
    for file in files:
        file.write_text("1,-1,10,10,20,60,1,-1,-1,-1\n")
    folders = write_still_pictures(tmp_path / "videos", "abcd", 20)
    words = ["check", *map(str, files), "--scene", str(tmp_path / "scene.json")]
    words += ["--out", str(tmp_path / "page"), "--videos", *map(str, folders)]
    assert cli.main(words) == 0
    assert [list(footage.camera_names) for footage, _ in pages] == [list(seen)]
    assert cli.main([*words, "--offsets", "0", "3", "5", "9"]) == 0
    assert pages[1][0].offsets == tuple((0, 3, 5, 9)["abcd".index(name)] for name in seen)
    assert cli.main([*words, "--offsets", "0", "3"]) == 1
    assert "There are 2 --offsets for 4 videos" in capsys.readouterr().err
    assert cli.main(words[:-1]) == 1
    assert "There are 3 videos for 4 cameras" in capsys.readouterr().err


@pytest.mark.parametrize("order", ["abcd", "dbca"])
def test_results_say_which_pictures_belong_to_their_boxes(order, tmp_path, pages):
    """Videos that began at different times show, and lack, the same instants as the run's boxes."""
    layout = make_layout("ring4", 0)
    results, scene = tmp_path / "results", tmp_path / "scene.json"
    results.mkdir()
    write_scene_json(results / "scene.json", layout.scene, list(order))
    write_scene_json(scene, layout.scene, list("abcd"))
    Detections([7], [0], [[1.0, 1, 5, 8]], clock=Clock(5.0)).save(results / "detections.npz")
    (results / "offsets.csv").write_text("camera,offset\nb,3\nd,-2\n")
    (results / "missing_pictures.csv").write_text("frame,camera\n9,b\n")
    folders = write_still_pictures(tmp_path / "videos", "abcd", 20)
    words = ["check", str(results), "--scene", str(scene), "--out", str(tmp_path / "page")]
    assert cli.main([*words, "--videos", *map(str, folders)]) == 0
    footage, outcome = pages[0]
    began = dict(zip("abcd", (0, 3, 0, -2), strict=True))
    assert footage.offsets == tuple(began[name] for name in order)
    assert footage.clock.frame_rate == 5
    frame, images = next(footage.instants_from(int(np.flatnonzero(footage.frames == 7)[0])))
    assert (frame, *(int(image.max()) for image in images)) == (
        7, *(7 + began[name] for name in order),
    )  # fmt: skip
    assert outcome.silent.tolist() == [[9, order.index("b")]]


def test_a_missing_scene_is_one_sentence(tmp_path, capsys):
    world = make_world("ring4", seed=2, frames=4, people=2)
    world.detections.save(tmp_path / "boxes.npz")
    words = ["check", str(tmp_path / "boxes.npz"), "--scene", str(tmp_path / "none.json")]
    assert cli.main(words) == 1
    assert capsys.readouterr().err.startswith("catfree: ")
