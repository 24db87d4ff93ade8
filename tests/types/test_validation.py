"""Wrong arguments are named in one sentence before anything is computed with them."""

import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.errors import InvalidInputError
from catfree.types import Detections
from catfree.types._validation import (
    MOST_BOXES,
    MOST_PEOPLE,
    as_boolean,
    as_duration,
    as_float,
    as_integer,
    as_number,
    as_path,
    as_paths,
    require_boxes_in_images,
    require_changing_pictures,
    require_different_cameras,
    require_few_people,
    require_instance,
    shown_camera,
)

# Without the tests' import hook, which would reject the types first.
SWAPPED = """
import numpy as np
import catfree as cf
from catfree import adapters, viz
from catfree.evaluation import bootstrap, combine_detection, combine_hota, combine_tracking
from catfree.evaluation import detection_metrics, ellipse_coverage
from catfree.methods.paper._assemble import empty_localization

rig = cf.Rig(
    np.tile([[900.0, 0, 960], [0, 900, 540], [0, 0, 1]], (2, 1, 1)),
    np.tile([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], (2, 1, 1)),
    [[0.0, 3, 0], [1, 3, 0]],
    (1920, 1080),
)
ground = cf.Plane([0, 0, 1], 0)
scene = cf.Scene(rig, ground, 10.0)
people = cf.Detections([0, 0], [0, 1], [[0, 0, 10, 20.0]] * 2)
rows = [[0, 0, 0.0, 0.0]]
metrics = detection_metrics(rows, rows)
found = empty_localization(2)
calls = {
    "Settings, confidence in percent": lambda: cf.Settings(confidence=30.0),
    "Settings, confidence NaN": lambda: cf.Settings(calibration_confidence=np.nan),
    "Scene, swapped": lambda: cf.Scene(ground, rig, 10.0),
    "Scene, no ground": lambda: cf.Scene(rig, None, 10.0),
    "localize, swapped": lambda: cf.localize(scene, people),
    "localize, a rig": lambda: cf.localize(people, rig),
    "localize, a name": lambda: cf.localize(people, scene, "paper"),
    "calibrate, nothing": lambda: cf.calibrate(None, (1920, 1080)),
    "calibrate, a name": lambda: cf.calibrate(people, (1920, 1080), "paper"),
    "calibrate, no list of anchors": lambda: cf.calibrate(people, (1920, 1080), anchors=5),
    "calibrate, an iterator of anchors": lambda: cf.calibrate(
        people, (1920, 1080), anchors=iter([cf.KnownCamera(0, height=3.0)])
    ),
    "check, no localization": lambda: cf.check(scene, people, localization=5),
    "refine, swapped": lambda: cf.refine(scene, people),
    "save, no path": lambda: people.save(None),
    "load, no path": lambda: cf.Scene.load(None),
    "read_scene, no path": lambda: cf.read_scene(5),
    "read_detections, no path": lambda: cf.read_detections(["a.csv", None]),
    "read_results, no path": lambda: cf.read_results(None),
    "write_results, swapped": lambda: cf.write_results(people, "folder"),
    "write_results, no outcome": lambda: cf.write_results("folder", people),
    "coverage, a rig": lambda: cf.coverage(rig),
    "run, a rig as scene": lambda: cf.run(["a.mp4", "b.mp4"], scene=rig),
    "run, a name as detector": lambda: cf.run(["a.mp4", "b.mp4"], detector="yolo"),
    "bootstrap, no metrics": lambda: bootstrap(None),
    "bootstrap, no level": lambda: bootstrap(metrics, level=None),
    "combine, a missing part": lambda: combine_detection([metrics, None]),
    "combine, no list": lambda: combine_tracking(metrics),
    "combine, of another kind": lambda: combine_hota([metrics]),
    "ellipse_coverage, no level": lambda: ellipse_coverage(rows, rows, [np.eye(2)], level=None),
    "plot_bird_eye, swapped": lambda: viz.plot_bird_eye(scene, found),
    "plot_bird_eye, no scene": lambda: viz.plot_bird_eye(found, people),
    "plot_coverage, swapped": lambda: viz.plot_coverage(scene, cf.coverage(scene)),
    "plot_gates, tracks": lambda: viz.plot_gates(found.tracks, scene),
    "plot_heat_map, tracks": lambda: viz.plot_heat_map(found.tracks),
    "write_heat_map, swapped": lambda: viz.write_heat_map(found, "heat.csv"),
    "write_glb, a localization": lambda: viz.write_glb("scene.glb", found),
    "write_overlay_video, no path": lambda: viz.write_overlay_video(None, [], people, found, scene),
    "write_colmap_text, swapped": lambda: adapters.write_colmap_text(rig, "folder"),
    "write_trackeval, swapped": lambda: adapters.write_trackeval(found.tracks, "folder", rows, [0]),
    "write_mot_boxes, tracks": lambda: adapters.write_mot_boxes("a.txt", found.tracks, [0]),
    "write_detections_parquet": lambda: adapters.write_detections_parquet("a.parquet", found),
    "detect_videos, paths": lambda: adapters.detect_videos(["a.mp4", "b.mp4"], print),
    "run_shards, nothing": lambda: cf.run_shards(None, scene=scene, out="folder"),
    "run_sites, a path": lambda: cf.run_sites("sites.toml", out="folder"),
}
for name, call in calls.items():
    try:
        call()
    except cf.CatFreeError as error:
        assert " must be a" in str(error), f"{name}: {error}"
    else:
        raise AssertionError(name)
"""


@pytest.mark.slow
def test_public_functions_name_arguments_of_another_type():
    done = subprocess.run([sys.executable, "-c", SWAPPED], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


# As above: parts of each call that its one sentence must contain.
MISTAKEN = """
import sys
import numpy as np
import catfree as cf
from catfree.adapters import NamedRig, SynchronizedVideos, write_anipose_toml, write_colmap_text
from catfree.adapters import read_ai_city, read_mv3dt, write_opencv_yaml, write_rig_json
from catfree.adapters import write_mot_ground, write_scene_json
from catfree.evaluation import align_centres, bootstrap, calibration_curve, detection_metrics
from catfree.evaluation import hota, tracking_metrics
from catfree.geometry import angular_residual, back_project, distort, intersect_ray, pixel_to_ray
from catfree.geometry import plane_distance, project, undistort
from catfree.filters import outside, suppress
from catfree.methods.paper._assemble import empty_localization
from catfree.settings import EvidenceSettings, TriangulationSettings
from catfree.synthetic import make_layout

scene = make_layout("ring4", 0).scene
folder, videos = sys.argv[1], sys.argv[2:]
footage = SynchronizedVideos(videos)
open_ = lambda **options: SynchronizedVideos(videos, **options)
names = [1, 2, 3, 4]
tracks = empty_localization(4).tracks
rig, pixels, points, up = scene.rig, np.ones((7, 2)), np.ones((7, 3)), np.eye(3)[2]
pose, lens = (rig.K[0], rig.R[0], rig.t[0]), np.zeros(5)
named = NamedRig(rig, tuple("abcd"))
outcome = cf.RunOutcome(
    empty_localization(4), cf.Detections([], [], []), scene, None, tuple("abcd"), np.zeros(0)
)
boxes = lambda frames: cf.Detections(frames, [0, 1], [[0, 0, 9, 9.0]] * 2)
none = cf.Detections([], [], [])
calls = {
    "finite numbers of shape (2,) or (3,)": lambda: cf.KnownCamera(0, position=((1,), (2, 3))),
    "stride[0] is": lambda: open_(stride=[1.5]),
    "stride is 1.5": lambda: open_(stride=1.5),
    "stride must be one whole number": lambda: open_(stride=[1]),
    "start is 1.5": lambda: open_(start=1.5),
    "end must hold whole numbers": lambda: open_(end="9"),
    "offsets[0] is nan": lambda: open_(offsets=[float("nan"), 0]),
    "offsets[1] is 1.7": lambda: open_(offsets=[0, 1.7]),
    "one number per camera (2), got 3": lambda: open_(offsets=3),
    "frame_rate is '2'; it must be a positive number": lambda: open_(frame_rate="2"),
    "paths must list one video per camera": lambda: SynchronizedVideos(5),
    "videos must list one video file or image folder per camera": lambda: cf.run(iter("ab")),
    "at least one video": lambda: SynchronizedVideos(None),
    "Camera 0 must be a path, got NoneType": lambda: SynchronizedVideos([None]),
    "no camera 9; the videos belong to cameras 0 to 1": lambda: next(footage.pictures_of(9)),
    "no camera -1": lambda: next(footage.pictures_of(-1)),
    "first is -1": lambda: next(footage.instants_from(-1)),
    "center must have shape (3), got (2,)": lambda: cf.camera_gain(scene, [0, 1], [1, 2, 3]),
    "target[1] is not finite": lambda: cf.camera_gain(scene, [0, 1, 5], [1, np.nan, 3]),
    "point must have shape (3,), got (7, 3). Use jax.vmap": lambda: project(*pose, points),
    "pixel must have shape (2,), got (7, 2). Use": lambda: back_project(rig.K[0], pixels),
    "pixel must have shape (2,), got (7, 2)": lambda: pixel_to_ray(*pose, pixels),
    "t must have shape (3,), got (4, 3)": lambda: pixel_to_ray(*pose[:2], rig.t, pixels[0]),
    "point must have shape (2,), got (7, 2). Use": lambda: distort(pixels, lens),
    "point must have shape (2,), got (7, 2)": lambda: undistort(pixels, lens),
    "position must have shape (3,), got (7, 3). Use": lambda: plane_distance(scene.ground, points),
    "position must have shape (3,), got (7, 3)": lambda: angular_residual(points, up, up),
    "origin must have shape (3,), got (7, 3)": lambda: intersect_ray(scene.ground, points, up),
    "area is 'abc'": lambda: cf.coverage(scene, "abc"),
    "area is 7": lambda: cf.coverage(scene, 7),
    "Expected numbers": lambda: align_centres("a", "b"),
    "must be two (C, 3) arrays": lambda: align_centres(1, 2),
    "registered[0] is neither": lambda: align_centres(np.eye(3), np.eye(3), registered=[3, 1, 1]),
    "name of camera 0 is 1": lambda: write_anipose_toml(f"{folder}/a.toml", scene.rig, names),
    "of camera 0 is 1": lambda: write_colmap_text(f"{folder}/colmap", scene.rig, names),
    "got Tracks. Pass its to_rows().": lambda: detection_metrics([], tracks),
    "got Localization. Pass its tracks.to_rows().": lambda: hota([], empty_localization(4)),
    "Expected numbers, got Scene.": lambda: hota([], scene),
    "camera_names has 1 names, but": lambda: cf.localize(none, scene, camera_names=["a"]),
    "camera_names must be a list, got str": lambda: cf.localize(none, scene, camera_names="abcd"),
    "camera_names must be a list, got ndarray": lambda: cf.check(
        scene, none, camera_names=np.array("a")
    ),
    "names must be a list, got str": lambda: write_rig_json(f"{folder}/r.json", rig, "abcd"),
    "camera_names must be a list of str, got NoneType": lambda: next(
        cf.watch([], cf.Tracker(scene), None, frame_rate=5)
    ),
    "lines must be lines of text, got NoneType": lambda: next(
        cf.watch(None, cf.Tracker(scene), "abcd", frame_rate=5)
    ),
    "tracker must be a Tracker, got Scene": lambda: next(
        cf.watch([], scene, list("abcd"), frame_rate=5)
    ),
    "camera_names must be a list of str, got float": lambda: cf.read_detections(folder, np.nan),
    "timestamps must list those of each camera": lambda: cf.adapters.on_common_clock(none, None),
    "confidence is None": lambda: cf.adapters.BackgroundDetector(None),
    "iou is 'a'": lambda: cf.adapters.YoloPoseOnnx("a.onnx", iou="a"),
    "maximum_points must hold whole": lambda: cf.adapters.VggtOnnx("a.onnx", maximum_points="a"),
    "unit is {}; it must be one of": lambda: cf.read_scene(folder, unit={}),
    "camera of a KnownCamera is None; it must": lambda: cf.KnownCamera(None, height=3.0),
    "focal_sd of a KnownCamera is None": lambda: cf.KnownCamera(0, height=3.0, focal_sd=None),
    "scale: Expected numbers, got NoneType": lambda: cf.geometry.Similarity(None, [[1]], [0]),
    "height: Expected numbers, got NoneType": lambda: cf.geometry.height_weight(None, 2.0),
    "distortion: Expected numbers, got NoneType": lambda: distort(pixels[0], None),
    "seeing must hold true and false": lambda: cf.filters.view_support_ratio([True], None),
    "score: Expected numbers, got str": lambda: cf.Detections([0], [0], [[0, 0, 1, 1]], "high"),
    "K: Expected numbers, got NoneType": lambda: cf.Rig(None, rig.R, rig.t, (9, 9)),
    "embeddings must hold true and false": lambda: cf.write_results(
        folder, outcome, embeddings="no"
    ),
    "scene must be a Scene, got str: read it with cf.read_scene": lambda: cf.check("a.json", none),
    "scene must be a Scene, got Detections": lambda: cf.rank_cameras(none),
    "longitude of a georeference is 'a'; it must be a finite": lambda: cf.GeoReference("a", "b"),
    "origin of a georeference must have shape (2), got": lambda: cf.GeoReference(1, 2, origin=3),
    "source must be a function of a camera": lambda: cf.rig_from_rays(None, *pose[1:], (9, 9)),
    "R must have shape (n, 3, 3), got (3, 3)": lambda: cf.rig_from_rays(print, *pose[1:], (9, 9)),
    "t must have shape (4, 3), got (3,)": lambda: cf.rig_from_rays(print, rig.R, pose[2], (9, 9)),
    "Expected numbers, got <U1 values": lambda: cf.rig_from_rays(print, ["R"], rig.t, (9, 9)),
    "got NamedRig. Pass its .rig and, as": lambda: write_anipose_toml(f"{folder}/a.toml", named),
    "must be a Rig, got NamedRig. Pass its": lambda: write_colmap_text(f"{folder}/colmap", named),
    "rig must be a Rig, got NamedRig. Pass": lambda: write_opencv_yaml(folder, named),
    "rig must be a Rig, got NamedRig": lambda: write_rig_json(f"{folder}/rig.json", named),
    "rig must be a Rig, got Scene. Pass its .rig.": lambda: write_opencv_yaml(folder, scene),
    "image_size must have shape (2), got (3,)": lambda: read_ai_city(folder, (9, 9, 3)),
    "image_size[1] is 0; it must be a width or": lambda: read_ai_city(folder, (9, 0)),
    "image_size must hold whole numbers": lambda: read_mv3dt([folder], "large"),
    "tracks [frame, id, x, y] must have shape (n, 4)": lambda: write_mot_ground(
        f"{folder}/a.txt", [1, 2], [0]
    ),
    "rig must be a Rig, got NoneType": lambda: write_opencv_yaml(folder, None),
    "scene must be a Scene, got NamedRig": lambda: write_scene_json(f"{folder}/a.json", named),
    "ground_truth must be an (N, 4) array": lambda: tracking_metrics(tracks, []),
    "[frame, id, x, y]. Expected an array, got lists": lambda: detection_metrics([[1], [1, 2]], []),
    "Expected numbers, got object.": lambda: detection_metrics(object(), []),
    "progress is True; it must be a function": lambda: cf.localize(none, scene, progress=True),
    "progress is 'bar'; it must be a function": lambda: cf.refine(
        boxes([0, 0]), scene, progress="bar"
    ),
    "rounds is 1.5": lambda: cf.refine(boxes([0, 0]), scene, rounds=1.5),
    "rounds is -1": lambda: cf.refine(boxes([0, 0]), scene, rounds=-1),
    "offset is 1.5": lambda: cf.calibrate(boxes([0, 0]), (9, 9), maximum_offset=1.5),
    "offset is -1": lambda: cf.calibrate(boxes([0, 0]), (9, 9), maximum_offset=-1),
    "maximum_offset is -2": lambda: cf.run(videos, maximum_offset=-2),
    "block_length must": lambda: bootstrap(detection_metrics([], [], [0]), block_length=None),
    "seed must hold whole numbers": lambda: bootstrap(detection_metrics([], [], [0]), seed="a"),
    "seed is -1": lambda: bootstrap(detection_metrics([], [], [0]), seed=-1),
    "radius: Expected numbers, got NoneType": lambda: suppress(pixels, np.ones(7), None),
    "accepted[2] is neither": lambda: outside(pixels, np.arange(7), 1.0),
    "Expected numbers, got <U1 values": lambda: calibration_curve(["a"], [1]),
    "Settings.evidence is {'gap': 2}; it must be": lambda: cf.Settings(evidence={"gap": 2}),
    "Settings.rays is None; it must be RaySettings(...)": lambda: cf.Settings(rays=None),
    "it must be CalibrationSettings(...)": lambda: cf.Settings(calibration=cf.Settings()),
    "must be one of 'paper', 'evidence'": lambda: cf.Settings(method="Paper"),
    "must be one of 'rays', 'best_pair'": lambda: TriangulationSettings(estimator="ray"),
    "track is 1; it must be True or False": lambda: EvidenceSettings(track=1),
    "passes is 2.5; it must be a whole number": lambda: EvidenceSettings(passes=2.5),
    "must be a tuple of 3 numbers, each 0 or": lambda: EvidenceSettings(edge_noise=(0.1, 0.1)),
    "must be a tuple of 2 numbers, each 0 or": lambda: EvidenceSettings(cover_ramp=[0.1, 0.2]),
    "each camera to its supervision.Detections": lambda: cf.Detections.from_supervision([none]),
    "such as {0: left, 1: right}, got [1, 2]": lambda: cf.Detections.from_supervision([1, 2]),
    "parts[1] must be a Detections, got int": lambda: cf.Detections.concatenate([none, 3]),
    "parts must be a list of Detections": lambda: cf.Detections.concatenate(None),
    "The column 'frame' must have shape (n), got ()": lambda: cf.Detections.from_table(
        {"frame": 0, "camera": 0, "x1": 0, "y1": 0, "x2": 1, "y2": 1}
    ),
    "frame goes from": lambda: boxes([-(2**62), 2**62]),
    "camera 0 is 1": lambda: write_scene_json(f"{folder}/scene.json", scene, names),
}
for needle, call in calls.items():
    try:
        call()
    except cf.CatFreeError as error:
        assert needle in str(error), f"{needle}: {error}"
        assert ".. " not in f"{error} ", error
    else:
        raise AssertionError(needle)
"""


@pytest.mark.slow
def test_mistaken_arguments_are_one_sentence(tmp_path):
    videos = [tmp_path / "videos" / name for name in ("a", "b")]
    for folder in videos:
        folder.mkdir(parents=True)
        for number in range(3):
            cv2.imwrite(str(folder / f"{number}.png"), np.zeros((4, 4, 3), np.uint8))
    command = [sys.executable, "-c", MISTAKEN, str(tmp_path), *map(str, videos)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["videos"]


# As above: the sentence must stay short, however long the argument is.
LONG = """
import numpy as np
import catfree as cf
from catfree.adapters import ReIdOnnx, SynchronizedVideos, VggtOnnx
from catfree.evaluation import crop, detection_metrics, detection_metrics_in_area
from catfree.filters import select
from catfree.methods.paper._assemble import empty_localization
from catfree.synthetic import make_layout, make_world
from catfree.synthetic.render._stage import build_stage
from catfree.viz import plot_bird_eye, plot_coverage

long = "x" * 5000
many = list(range(5000))
scene = make_layout("ring4", 0).scene
boxes = cf.Detections([0, 0], [0, 1], [[0, 0, 9, 9.0]] * 2)
rows = np.zeros((0, 4))
known = cf.KnownCamera(long, height=3.0)
names = [long, long + "y", "b", "c"]
calls = {
    "detector": lambda: cf.run(["a", "b"], detector=long),
    "videos": lambda: cf.run(long),
    "layout": lambda: make_layout(long),
    "number of a layout": lambda: make_layout("ring" + "9" * 5000),
    "raised number of a layout": lambda: make_layout("ring\u00b2"),
    "camera of an anchor": lambda: cf.calibrate(boxes, (9, 9), anchors=[known]),
    "names of cameras": lambda: cf.calibrate(
        boxes, (9, 9), anchors=[cf.KnownCamera("a", height=3.0)], camera_names=names[:2]
    ),
    "anchor of nothing": lambda: cf.KnownCamera(long),
    "position of an anchor": lambda: cf.KnownCamera("a", position=["u"] * 5000),
    "compat": lambda: detection_metrics(rows, rows, compat=long),
    "area of crop": lambda: crop(rows, many),
    "order of an area": lambda: crop(rows, {"x": (2, 1), "y": (2, 1), long: long}),
    "outside": lambda: detection_metrics_in_area(rows, rows, (0, 1, 0, 1), outside=long),
    "area of coverage": lambda: cf.coverage(scene, many),
    "gates": lambda: select(np.ones(1), np.ones(1), np.ones(1), np.ones(1, bool), gates=long),
    "quantity": lambda: plot_coverage(cf.coverage(scene), scene, quantity=long),
    "area of a plot": lambda: plot_bird_eye(empty_localization(4), scene, area=many),
    "preprocessing": lambda: ReIdOnnx("a.onnx", preprocessing=long),
    "mode": lambda: VggtOnnx("a.onnx", mode=long),
    "site": lambda: cf.shards(["a.csv"], site=long),
    "shadows": lambda: build_stage(make_world("ring4", frames=1, people=1), long),
    "on_error": lambda: SynchronizedVideos(["a", "b"], on_error=long),
    "confidence": lambda: cf.Settings(confidence=10**5000),
    "twice": lambda: cf.Detections.from_supervision({long: []}, camera_names=[long, long]),
}
for name, call in calls.items():
    try:
        call()
    except cf.CatFreeError as error:
        assert len(str(error)) < 500, f"{name}: {len(str(error))}, {error}"
    else:
        raise AssertionError(name)
"""


@pytest.mark.slow
def test_long_arguments_make_no_long_sentence():
    done = subprocess.run([sys.executable, "-c", LONG], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


# As above: all readers refuse values that are not paths, and names impossible for a file.
PATHS = """
import catfree as cf
from catfree import adapters
from catfree.adapters import SynchronizedVideos

readers = {
    name: getattr(module, name)
    for module in (cf, adapters)
    for name in dir(module)
    if name.startswith("read_")
}
readers |= {
    "read_missing_pictures": lambda path: adapters.read_missing_pictures(path, ["a"]),
    "Scene.load": cf.Scene.load,
    "Detections.load": cf.Detections.load,
    "SynchronizedVideos": lambda path: SynchronizedVideos([path]),
    "YoloPoseOnnx": adapters.YoloPoseOnnx,
    "run": lambda path: cf.run([path, path]),
    "run with a scene": lambda path: cf.run(["a", "b"], scene=path if path else 5),
    "shards": lambda path: cf.shards(path),
    "shards of videos": lambda path: cf.shards([path, path]),
    "open_tracks": cf.open_tracks,
    "join": cf.join,
}
wrong = {
    "x" * 5000: "too long for a path",
    "x/" * 5000 + "a": "too long for a path",
    "a\\0b": "character that paths cannot have",
    None: "",
    3: "",
    ("a", None): "",
}
raised = []
for name, read in readers.items():
    for path, needle in wrong.items():
        try:
            read(list(path) if isinstance(path, tuple) else path)
        except Exception as error:
            said = f"{name}({str(path)[:20]}): {type(error).__name__}: {str(error)[:600]}"
            if not isinstance(error, cf.CatFreeError) or needle not in said or len(said) > 600:
                raised.append(said)
        else:
            raised.append(f"{name}({str(path)[:20]}) raises nothing")
assert not raised, "\\n".join(raised)
"""


@pytest.mark.slow
def test_every_reader_refuses_what_is_no_path():
    done = subprocess.run([sys.executable, "-c", PATHS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


def test_names_of_existing_files_are_paths(tmp_path):
    longest = tmp_path / ("x" * 255)
    longest.write_text("")
    assert as_path(str(longest), "path") == longest
    assert as_path(longest, "path") == longest
    assert as_path("nowhere/at/all", "path") == Path("nowhere/at/all")
    assert as_path("~/boxes.csv", "path") == Path.home() / "boxes.csv"
    assert as_path("./~/boxes.csv", "path") == Path("~/boxes.csv")
    name = "x" * 256
    with pytest.raises(InvalidInputError, match=r"^path is 'xxx.*xxx', which is too long for a"):
        as_path(name, "path")
    with pytest.raises(InvalidInputError, match="has a character that paths cannot have"):
        as_path("a\0b", "path")


def test_instances_are_named_by_argument_and_type():
    require_instance(Detections([], [], []), Detections, "detections")
    with pytest.raises(InvalidInputError, match="detections must be a Detections, got list"):
        require_instance([], Detections, "detections")
    with pytest.raises(InvalidInputError, match=r"Path: read it with cf\.read_detections"):
        require_instance(Path("boxes"), Detections, "detections")
    with pytest.raises(InvalidInputError, match=r"make one with cf\.Detections\.from_table"):
        require_instance(SimpleNamespace(columns=["frame"]), Detections, "detections")


@pytest.mark.parametrize(("value", "kind"), [(None, "NoneType"), (3, "int"), (b"a", "bytes")])
@pytest.mark.parametrize("convert", [as_path, as_paths])
def test_what_is_no_path_is_named_by_its_type(value, kind, convert):
    with pytest.raises(InvalidInputError, match=rf"^path must be a path, got {kind}\.$"):
        convert(value, "path")


def test_an_empty_path_is_not_the_current_folder():
    with pytest.raises(InvalidInputError, match=r"^path is empty\. Give a path"):
        as_path("", "path")
    assert as_path(".", "path") == Path()


@pytest.mark.parametrize(
    "read", [as_float, lambda v: as_integer(v, "frame"), lambda v: as_boolean(v, "registered")]
)
def test_lists_of_different_lengths_are_no_array(read):
    with pytest.raises(InvalidInputError, match="different lengths"):
        read([[0, 1], [1]])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.array([3, 2**64 - 1], np.uint64), r"frame\[1\] is 18446744073709551615"),
        (np.array(2**63, np.uint64), "frame is 9223372036854775808"),
        ([[0.0, 1.5]], r"frame\[0, 1\] is 1.5; it must be a whole number"),
        (np.array([1 + 2j]), "frame must hold whole numbers, got dtype complex128"),
    ],
)
def test_whole_numbers_that_int64_cannot_hold_are_refused(value, message):
    with pytest.raises(InvalidInputError, match=message):
        as_integer(value, "frame")


def test_numbers_up_to_63_bits_stay_what_they_are():
    for value in (2**63 - 1, np.uint64(2**63 - 1), -(2**63)):
        assert as_integer([value], "frame")[0] == value


def test_masks_are_not_dropped():
    with pytest.raises(InvalidInputError, match="masked entries"):
        Detections(np.ma.array([0, 1], mask=[0, 1]), [0, 0], [[0, 0, 1, 1]] * 2)
    boxes = np.ma.masked_invalid([[0, 0, 1, 1], [0, 0, 1, np.nan]])
    with pytest.raises(InvalidInputError, match="masked entries"):
        Detections([0, 1], [0, 0], boxes)
    np.testing.assert_array_equal(Detections([0], [0], boxes[:1]).box, boxes[:1])


def test_imaginary_parts_are_not_dropped():
    for value in ([1j], np.array([1 + 0j]), jnp.array([1j]), np.array(["2020"], "datetime64[Y]")):
        with pytest.raises(InvalidInputError, match="Expected real numbers"):
            as_float(value)


@pytest.mark.parametrize(
    "value",
    [["1", "2"], np.array([b"3.14159"], "S3"), np.array([1, "2"], object), np.zeros(2, "V8")],
)
def test_digits_in_text_are_not_numbers(value):
    with pytest.raises(InvalidInputError, match="Expected numbers"):
        as_float(value)


def test_empty_lists_are_detections_without_rows():
    nobody = Detections([], [], [], [], [], [], [])
    assert len(nobody) == 0
    assert nobody.keypoints is not None
    assert nobody.keypoints.shape == (0, 17, 3)
    assert nobody.embedding is not None
    assert nobody.embedding.shape == (0, 0)


@pytest.mark.parametrize("value", [None, "3", np.nan, np.inf, [1.0], True, 1j])
def test_what_is_not_one_finite_number_is_refused(value):
    for convert in (as_number, as_duration):
        with pytest.raises(InvalidInputError, match="time"):
            convert(value, "time")


def test_a_duration_is_not_negative():
    assert (as_number(np.int32(-2), "time"), as_duration(0, "lag")) == (-2.0, 0.0)
    with pytest.raises(
        InvalidInputError, match="lag is -2; it must be a number of seconds, 0 or more"
    ):
        as_duration(-2, "lag")


@given(st.integers(0, 10**6), st.integers(10, 20), st.integers(1, 3), st.integers(0, 2))
def test_a_camera_whose_picture_never_changes_is_named(seed, frames, count, frozen):
    rng = np.random.default_rng(seed)
    box = rng.uniform(0, 500, (3, frames, count, 4))
    box[frozen] = box[frozen, 0]
    camera, frame, _ = np.indices(box.shape[:-1])
    mixed = rng.permutation(camera.size)

    def judge(box):
        rows = (frame.ravel(), camera.ravel(), box.reshape(-1, 4))
        require_changing_pictures(*(part[mixed] for part in rows), ["a", "b", "c"])

    told = rf"Camera '{'abc'[frozen]}' has exactly the same boxes \({count}\) in all its {frames} "
    with pytest.raises(InvalidInputError, match=told):
        judge(box)
    judge(np.broadcast_to(box[:, :1], box.shape))  # no one moves
    box[frozen, frames // 2, 0, 1] += 1e-9
    judge(box)


def boxes_of(rng, count):
    return np.arange(count) // 2, rng.uniform(0, 500, (count, 4))


@given(st.integers(0, 10**6), st.integers(10, 30), st.permutations(range(3)))
def test_a_camera_given_twice_is_named_whatever_the_order_of_its_boxes(seed, count, order):
    rng = np.random.default_rng(seed)
    frame, box = boxes_of(rng, count)
    other = boxes_of(rng, count)[1]
    mixed = rng.permutation(count)
    frames, cameras = np.concatenate([frame, frame, frame[mixed]]), np.repeat(order, count)
    boxes = np.concatenate([box, other, box[mixed]])
    low, high = sorted((order[0], order[2]))
    with pytest.raises(
        InvalidInputError, match=f"Cameras {low} and {high} have the same {count} boxes"
    ):
        require_different_cameras(frames, cameras, boxes)
    with pytest.raises(InvalidInputError, match=f"'{'abc'[low]}' and '{'abc'[high]}'"):
        require_different_cameras(frames, cameras, boxes, ["a", "b", "c"])
    with pytest.raises(InvalidInputError, match=f"and {high} have"):  # too few names
        require_different_cameras(frames, cameras, boxes, ["a"])
    # One pixel is enough to distinguish two videos, and few boxes are equal by chance.
    boxes[-1, 0] += 1
    require_different_cameras(frames, cameras, boxes)
    require_different_cameras(np.zeros(18, int), np.repeat([0, 1], 9), np.zeros((18, 4)))


@given(st.integers(0, 40), st.integers(0, 1), st.sampled_from([0, 1]), st.booleans())
def test_boxes_beyond_the_image_tell_its_size_is_wrong(outside, camera, axis, before):
    """Which camera, which side and how many: a quarter may be people at the border."""
    count, size = 40, np.array([[100, 80], [60, 90]])
    center = np.tile(size[camera] / 2.0, (count, 1))
    center[:outside, axis] = -1.0 if before else size[camera, axis] + 1.0
    box = np.concatenate([center - 3, center + 3], axis=1)
    cameras = np.full(count, camera)
    if outside > count / 4:
        share = f"{outside / count:.0%} of the boxes of camera {camera} have"
        with pytest.raises(InvalidInputError, match=share):
            require_boxes_in_images(cameras, box, size)
        with pytest.raises(
            InvalidInputError, match=f"camera '{'ab'[camera]}' .*{size[camera, 0]} x"
        ):
            require_boxes_in_images(cameras, box, size, ["a", "b"])
    else:
        require_boxes_in_images(cameras, box, size)
    require_boxes_in_images(cameras[:9], box[:9], size)


@given(st.integers(0, 2), st.integers(-(2**62), 2**62), st.integers(0, 10**6))
def test_a_picture_of_more_people_than_any_is_named(crowded, number, seed):
    rng = np.random.default_rng(seed)
    camera = np.concatenate([np.full(MOST_PEOPLE, crowded), rng.integers(0, 3, 2000)])
    frame = np.concatenate([np.full(MOST_PEOPLE, number), number + rng.permutation(2000) + 1])
    order = rng.permutation(len(frame))
    require_few_people(frame[order], camera[order])
    require_few_people(frame[:0], camera[:0])
    frame[MOST_PEOPLE] = number
    camera[MOST_PEOPLE] = crowded
    with pytest.raises(InvalidInputError, match=f"Camera {crowded} has 1001 .* frame {number};"):
        require_few_people(frame[order], camera[order])
    with pytest.raises(InvalidInputError, match=f"Camera '{'abc'[crowded]}' has 1001 boxes"):
        require_few_people(frame[order], camera[order], ["a", "b", "c"])


@given(st.integers(6, 12), st.integers(-(2**62), 2**62), st.integers(0, 10**6))
def test_an_instant_of_more_boxes_than_any_crowd_gives_is_named(cameras, number, seed):
    rng = np.random.default_rng(seed)
    camera = np.arange(MOST_BOXES + 3000) % cameras
    frame = np.where(np.arange(len(camera)) < MOST_BOXES, number, number + 1)
    order = rng.permutation(len(frame))
    require_few_people(frame[order], camera[order])
    frame[MOST_BOXES] = number
    with pytest.raises(
        InvalidInputError, match=rf"Frame {number} has 5001 boxes in {cameras} cameras; .* 5000\."
    ):
        require_few_people(frame[order], camera[order])


def test_names_of_cameras_are_cut_only_if_they_are_long():
    assert [shown_camera(at, ["a", "it's"]) for at in range(3)] == ["'a'", '"it\'s"', "2"]
    assert shown_camera(0, ["x" * 100]) == repr("x" * 100)
    assert len(shown_camera(0, ["x" * 5000])) < 150


def test_floats_of_any_byte_order_keep_their_width():
    for kind, width in ((">f4", np.float32), ("<f4", np.float32), (">f8", np.float64)):
        assert as_float(np.ones(3, kind)).dtype == width
    own = np.ones(3, np.float32)
    assert as_float(own) is own


def test_whole_numbers_beyond_all_floats_are_refused():
    with pytest.raises(InvalidInputError, match="Expected numbers"):
        as_float(np.array([1, 10**400], object))


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_whole_numbers_of_any_width_are_read_without_a_warning(dtype):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = as_integer(np.array([0, -3, 2048], dtype), "frame")
        with pytest.raises(InvalidInputError, match=r"frame\[1\]"):
            as_integer(np.array([0, np.nan], dtype), "frame")
    assert read.tolist() == [0, -3, 2048]
