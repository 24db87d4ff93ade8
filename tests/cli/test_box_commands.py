"""`localize`, `calibrate` and `evaluate` on files of boxes."""

import json
from dataclasses import replace

import numpy as np
import pytest

import catfree as cf
from catfree import cli
from catfree.adapters import (
    read_scene,
    read_tracks,
    write_anipose_toml,
    write_mot_boxes,
    write_scene_json,
    write_tracks_csv,
)
from catfree.synthetic import make_world
from catfree.synthetic._layouts import ring
from catfree.types import Scene, Tracks

pytestmark = pytest.mark.slow

pytest.importorskip("tyro")

FRAMES, SIZE = 60, (1280, 720)
NAMES = ("north", "east", "west")


@pytest.fixture(scope="module")
def world():
    return make_world(ring(3, image_size=SIZE, people=6), frames=FRAMES, people=6)


@pytest.fixture(scope="module")
def boxes(world, tmp_path_factory):
    folder = tmp_path_factory.mktemp("boxes")
    for camera, name in enumerate(NAMES):
        part = world.detections[world.detections.camera == camera]
        write_mot_boxes(folder / f"{name}.txt", part, range(FRAMES))
    return folder


def sentence(capsys):
    error = capsys.readouterr().err.strip()
    assert error.startswith("catfree: ")
    assert "\n" not in error
    return error


def test_boxes_in_another_order_than_the_scene(world, boxes, tmp_path, capsys):
    turned = np.array([2, 0, 1])
    rig = world.true_rig.select(turned)
    scene = tmp_path / "calibration.toml"
    write_anipose_toml(scene, rig, [NAMES[c] for c in turned], metres_per_unit=0.001)
    files = [str(boxes / f"{name}.txt") for name in NAMES]
    out = tmp_path / "results"
    words = ["localize", *files, "--scene", str(scene), "--unit", "mm", "--out", str(out)]
    assert cli.main([*words, "--frame-rate", "5", "--no-pictures"]) == 0
    assert "they were matched by name" in capsys.readouterr().err
    tracks = read_tracks(out)
    seen, _ = cf.read_detections(boxes, NAMES)
    ground = cf.Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    expected = cf.localize(seen, Scene.from_rig(world.true_rig, ground, metric=True)).tracks
    np.testing.assert_allclose(tracks.to_rows(), expected.to_rows(), atol=1e-4)
    assert tracks.clock is not None
    assert tracks.clock.frame_rate == 5
    assert {path.name for path in out.iterdir()} >= {"scene.json", "report.html", "boxes", "rig"}
    truth = np.add(world.ground_truth, [1, 0, 0, 0])
    np.savetxt(
        tmp_path / "truth.csv",
        truth,
        "%.17g",
        ",",
        header="frame,id,x,y",
        comments="",
    )
    assert cli.main(["evaluate", str(out), str(tmp_path / "truth.csv")]) == 0
    moda = next(line for line in capsys.readouterr().out.splitlines() if "MODA" in line)
    metrics = cf.evaluation.detection_metrics(truth, tracks.to_rows(), range(1, FRAMES + 1))
    assert float(moda.split("│")[2]) == pytest.approx(metrics.moda, abs=0.01)


def test_boxes_of_one_camera_of_the_scene_are_told_so(world, boxes, tmp_path, capsys):
    write_scene_json(tmp_path / "scene.json", world.scene, NAMES)
    words = ["localize", str(boxes / "east.txt"), "--scene", str(tmp_path / "scene.json")]
    assert cli.main([*words, "--out", str(tmp_path / "out"), "--no-pictures"]) == 1
    said = sentence_after_table(capsys)
    assert "needs boxes of at least 2 cameras. There are no boxes of these cameras" in said
    assert "north, west" in said


def test_nothing_is_concluded_from_missing_pictures(world, boxes, tmp_path):
    missing = np.array([[frame, 1] for frame in range(30, 45)])
    seen = world.detections
    seen = seen[~((seen.camera == 1) & np.isin(seen.frame, missing[:, 0]))]
    seen.save(tmp_path / "boxes.npz")
    write_scene_json(tmp_path / "scene.json", world.scene)
    (tmp_path / "missing.csv").write_text(
        "frame,camera\n" + "".join(f"{frame},{camera}\n" for frame, camera in missing)
    )
    words = ["localize", str(tmp_path / "boxes.npz"), "--scene", str(tmp_path / "scene.json")]
    words += ["--frame-rate", "5", "--no-pictures", "--out", str(tmp_path / "out")]
    assert cli.main([*words, "--silent", str(tmp_path / "missing.csv")]) == 0
    found = read_tracks(tmp_path / "out")
    expected = cf.localize(seen, world.scene, silent=missing).tracks
    np.testing.assert_array_equal(found.existence, expected.existence)
    assert not np.array_equal(cf.localize(seen, world.scene).tracks.existence, expected.existence)
    # The results folder stores them, but no embeddings.
    words[1], words[-1] = str(tmp_path / "out"), str(tmp_path / "again")
    assert cli.main(words) == 0
    expected = cf.localize(replace(seen, embedding=None), world.scene, silent=missing).tracks
    found = read_tracks(tmp_path / "again")
    np.testing.assert_allclose(found.existence, expected.existence, atol=1e-9)


def test_boxes_of_cameras_named_by_numbers(world, tmp_path, capsys):
    names = np.array(["1", "2", "3"])
    write_scene_json(tmp_path / "scene.json", world.scene, tuple(names))
    seen = world.detections[world.detections.camera != 2]
    table = seen.to_pandas()
    table["camera"] = names[seen.camera]
    table.to_csv(tmp_path / "boxes.csv", index=False)
    out = tmp_path / "results"
    words = ["localize", str(tmp_path / "boxes.csv"), "--scene", str(tmp_path / "scene.json")]
    assert cli.main([*words, "--out", str(out), "--no-pictures"]) == 0
    known, _ = read_scene(tmp_path / "scene.json")
    expected = cf.localize(seen, replace(known, rig=known.rig.select([0, 1]))).tracks
    np.testing.assert_allclose(read_tracks(out).to_rows(), expected.to_rows(), atol=0.01)


def test_boxes_without_a_row_are_of_all_cameras(world, tmp_path, capsys):
    (tmp_path / "boxes.csv").write_text("frame,camera,x1,y1,x2,y2\n")
    write_scene_json(tmp_path / "scene.json", world.scene, NAMES)
    words = ["localize", str(tmp_path / "boxes.csv"), "--scene", str(tmp_path / "scene.json")]
    assert cli.main([*words, "--out", str(tmp_path / "out"), "--no-pictures"]) == 0
    assert "from 3 of 3 cameras" in capsys.readouterr().out


def test_a_box_in_a_missing_picture_is_told_before_the_cameras_are_found(boxes, tmp_path, capsys):
    (tmp_path / "missing.csv").write_text("frame,camera\n3,west\n")
    words = ["localize", str(boxes), "--image-size", *map(str, SIZE), "--out", str(tmp_path / "o")]
    assert cli.main([*words, "--silent", str(tmp_path / "missing.csv")]) == 1
    assert "has no picture of frame 3, but there is a box" in sentence_after_table(capsys)
    assert not (tmp_path / "o").exists() or not list((tmp_path / "o").rglob("*.npz"))


def test_an_anchor_of_no_camera_is_told_before_anything_is_written(boxes, tmp_path, capsys):
    (tmp_path / "anchors.json").write_text('{"cameras": [{"camera": "nord", "height": 4}]}')
    words = ["calibrate", str(boxes), "--image-size", *map(str, SIZE), "--out", str(tmp_path / "o")]
    assert cli.main([*words, "--anchors", str(tmp_path / "anchors.json")]) == 1
    assert "camera 'nord', but the cameras are" in sentence_after_table(capsys)
    assert not (tmp_path / "o").exists()


def test_cameras_from_boxes(world, boxes, tmp_path, capsys):
    out = tmp_path / "rig"
    words = ["calibrate", str(boxes), "--out", str(out)]
    assert cli.main(words) == 1
    assert "needs the image sizes: give --image-size" in sentence_after_table(capsys)
    assert cli.main([*words, "--image-size", "400", "300"]) == 1
    said = sentence_after_table(capsys)
    assert "outside its image of 400 x 300 px. Give --image-size" in said
    assert said.endswith("found in, or COCO files, which state it, if cameras differ.")
    assert cli.main([*words, "--image-size", *map(str, SIZE)]) == 0
    scene, names = read_scene(out)
    assert names == tuple(sorted(NAMES))
    assert scene.rig.registered.all()
    assert scene.metric
    known = {
        "cameras": [
            {"camera": name, "position": np.asarray(world.true_rig.centers)[at].tolist()}
            for at, name in enumerate(NAMES)
        ]
    }
    (tmp_path / "anchors.json").write_text(json.dumps(known))
    words += ["--image-size", *map(str, SIZE), "--anchors", str(tmp_path / "anchors.json")]
    assert cli.main(words) == 0
    surveyed, names = read_scene(out)
    truth = np.asarray(world.true_rig.centers)[[NAMES.index(name) for name in names]]
    sd = cf.KnownCamera.position_sd
    np.testing.assert_allclose(np.asarray(surveyed.rig.centers), truth, atol=2 * sd)
    assert np.abs(np.asarray(scene.rig.centers) - truth).max() > 1  # in its own frame
    (tmp_path / "anchors.json").write_text('{"distances": [{"camera": "nord"}]}')
    assert cli.main(words) == 1
    assert "entry 0 of distances" in sentence_after_table(capsys)


def sentence_after_table(capsys):
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_mistakes_are_one_sentence(world, boxes, tmp_path, capsys):
    scene = tmp_path / "calibration.toml"
    write_anipose_toml(scene, world.true_rig, NAMES)
    north, east = str(boxes / "north.txt"), str(boxes / "east.txt")
    (tmp_path / "a.mp4").write_bytes(b"")
    for words, expected in [
        (["localize", str(tmp_path / "none")], "There is no file or folder"),
        (["localize", north, east, "--scene", str(tmp_path / "no")], "There is no file"),
        (["run", north, east], "(.txt), not like a video. Give the boxes to catfree"),
        (["calibrate", north, str(tmp_path / "a.mp4")], "north.txt ends like a file of boxes"),
    ]:
        assert cli.main([*words, "--out", str(tmp_path / "out")]) == 1
        assert expected in sentence(capsys)
    words = ["localize", str(boxes), "--scene", str(scene), "--max-offset", "3"]
    assert cli.main([*words, "--out", str(tmp_path / "out")]) == 1
    assert "a largest offset apply to cameras found from people" in sentence_after_table(capsys)
    other = tmp_path / "south.txt"
    other.write_text((boxes / "north.txt").read_text())
    words = ["localize", str(other), east, "--scene", str(scene), "--out", str(tmp_path / "out")]
    assert cli.main(words) == 1
    assert "which are not all among them" in sentence_after_table(capsys)


@pytest.mark.parametrize(
    "option",
    [
        ["--detector", "n.onnx"],
        ["--stride", "2"],
        ["--offsets", "0", "1"],
        ["--keep-before-damage"],
    ],
)
def test_options_of_videos_are_refused_with_boxes(option, boxes, tmp_path, capsys):
    words = ["calibrate", str(boxes / "north.txt"), str(boxes / "east.txt"), *option]
    assert cli.main([*words, "--out", str(tmp_path / "out")]) == 1
    assert "is read as boxes, so --detector, --stride, --offsets" in sentence(capsys)
    assert not (tmp_path / "out").exists()


def test_a_benchmark_is_scored_by_its_protocol(tmp_path, capsys):
    folder = tmp_path / "annotations_positions"
    folder.mkdir()
    views = [{"viewNum": c, "xmin": 1, "ymin": 1, "xmax": 9, "ymax": 30} for c in range(7)]
    for frame in range(1780, 1840, 5):
        person = {"personID": 4, "positionID": 480 * 700 + 240, "views": views}
        (folder / f"{frame:08d}.json").write_text(json.dumps([person]))
    frames = np.arange(1780, 1840, 5)
    n = len(frames)
    tracks = Tracks(
        frame=frames,
        track_id=np.zeros(n, int),
        position=np.tile([3.1, 8.5, 0.0], (n, 1)),
        ground_xy=np.tile([3.1, 8.5], (n, 1)),
        sigma=np.ones(n),
        covariance=np.tile(np.eye(2), (n, 1, 1)),
        supporting_cameras=np.full(n, 2),
        origin=np.zeros(n, int),
    )
    write_tracks_csv(tmp_path / "tracks.csv", tracks)
    words = ["evaluate", str(tmp_path / "tracks.csv"), str(tmp_path)]
    assert cli.main(words) == 0
    shown = capsys.readouterr().out
    assert "Protocol: WildTrack, test split (8 frames, 1800 to 1835)" in " ".join(shown.split())
    assert "100.00" in shown
    assert cli.main([*words, "--threshold", "0.05", "--split", "all"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "all frames (12 frames" in shown
    assert "(but with other distances)" in shown
    write_tracks_csv(tmp_path / "tracks.csv", tracks[:2])
    assert cli.main(words) == 1
    assert "common: 1780 to 1785 and 1800 to 1835. Use the same frame numbers" in sentence(capsys)
