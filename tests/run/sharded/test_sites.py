"""Lists of sites are read as written, or errors name the entry; a site is calibrated once."""

import dataclasses
import json
import re
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from datetime import date
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree._run import _stages
from catfree._run._cache import content_hash
from catfree._run._run import run_stages
from catfree._run.sharded import _sites
from catfree._run.sharded._plan_file import METHODS
from catfree._run.sharded._sites import Site, read_sites, run_sites
from catfree.adapters import write_anipose_toml, write_detections_parquet, write_scene_json
from catfree.adapters.calibration_files._rig_json import scene_text
from catfree.adapters.datasets._detection_files import CameraBoxes
from catfree.adapters.datasets._scene_files import METERS
from catfree.errors import CalibrationError, FileFormatError, InvalidInputError, ShardError
from catfree.synthetic import make_world

texts = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), min_size=1, max_size=12)
rates = st.integers(1, 100) | st.floats(0.1, 100)
sizes = st.lists(st.tuples(st.integers(1, 4000), st.integers(1, 4000)).map(list), max_size=3)
recordings = st.lists(texts, max_size=3).map(lambda v: {"videos": v}) | texts.map(
    lambda path: {"detections": path}
)
options = {
    "date": st.dates(date(1900, 1, 1)) | texts, "scene": texts, "image_size": sizes,
    "frame_rate": rates, "anchors": texts,
    "silent": texts, "unit": st.sampled_from(sorted(METERS)),
}  # fmt: skip
rows = st.builds(
    lambda name, recording, more: {"name": name} | recording | more,
    texts,
    recordings,
    st.fixed_dictionaries({}, optional=options),
)
heads = st.fixed_dictionaries(
    {},
    optional={
        "every": rates, "overlap": rates, "method": st.sampled_from(METHODS), "detector": texts,
        "embedder": texts,
    },
)  # fmt: skip


def toml(value):
    """Format a value as TOML."""
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, str | bool | int) else repr(value)


def write(folder, head, sites):
    lines = [f"{json.dumps(key)} = {toml(value)}" for key, value in head.items()]
    path = folder / "sites.toml"
    path.write_text("\n".join([*lines, f"site = {toml(sites)}"]), encoding="utf-8")
    return path


@pytest.mark.slow
@given(heads, st.lists(rows, min_size=1, max_size=3))
def test_a_list_is_read_as_it_stands(tmp_path_factory, head, sites):
    folder = tmp_path_factory.mktemp("sites")
    found, options = read_sites(write(folder, head, sites))
    for name in ("detector", "embedder"):
        if name in head:
            head[name] = str(folder / head[name])
    assert options == head
    assert len(found) == len(sites)
    for site, row in zip(found, sites, strict=True):
        assert site.name == row["name"]
        assert site.date == str(row.get("date", ""))
        assert site.frame_rate == row.get("frame_rate")
        assert site.scene == (str(folder / row["scene"]) if "scene" in row else None)
        assert site.silent == (str(folder / row["silent"]) if "silent" in row else ())
        assert site.unit == row.get("unit")
        if "videos" in row:
            assert site.recording == tuple(str(folder / video) for video in row["videos"])
        else:
            assert site.recording == str(folder / row["detections"])
        size = row.get("image_size")
        assert site.image_size == (None if size is None else tuple(map(tuple, size)))


anything = st.recursive(
    st.booleans() | st.integers() | st.floats() | texts | st.dates(date(1000, 1, 1)),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=5,
)


@given(heads, st.lists(rows, min_size=1, max_size=2), st.data())
def test_a_list_with_a_mistake_is_read_or_refused_by_name(tmp_path_factory, head, sites, data):
    place = data.draw(st.sampled_from([head, *sites]))
    key = data.draw(texts | st.sampled_from([*heads_and_rows(), "site"]))
    place[key] = data.draw(anything)
    if place is head and key == "site":
        sites = place.pop(key)
    path = write(tmp_path_factory.mktemp("sites"), head, sites)
    found, said = None, ""
    try:
        found, _ = read_sites(path)
    except FileFormatError as error:
        said = str(error)
    assert found or str(path) in said


def heads_and_rows():
    return ("every", "overlap", "method", "detector", "name", "videos", "detections", *options)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("every = ", "is not valid TOML"),
        (".".join(["a"] * 20000) + " = 1", "line 1 has 19999 dots; a list of sites has at most 16"),
        ("#" * 2**20 + "\n", "has 1048577 characters; a list of sites has at most 1048576"),
        (
            "every = nan\n[[site]]\nname = 'a'\ndetections = 'a'",
            "every of the file is nan; it must",
        ),
        (
            "overlap = -inf\n[[site]]\nname = 'a'\ndetections = 'a'",
            "overlap of the file is -inf; it",
        ),
        ("every = 6", r"has no \[\[site\]\]"),
        ("site = 3", "site of the file is 3"),
        ("site = [3]", "site 0 must be a table"),
        ("speed = 6", "the file has no key 'speed'; it has every, overlap"),
        ("every = true", "every of the file is True"),
        (
            "method = 'paper '\n[[site]]\nname = 'a'\ndetections = 'a'",
            "method of the file is 'paper '",
        ),
        ("[[site]]\nname = 'a'", "site 0 needs a name and either videos or detections"),
        ("[[site]]\nname = 'a'\nvideos = ['a']\ndetections = 'a'", "needs a name and either"),
        ("[[site]]\ndetections = 'a'", "needs a name"),
        ("[[site]]\nname = 'a'\nvideos = [1, 2]", "videos of site 0 is 1; it must be text"),
        ("[[site]]\nname = 'a'\ndetections = 'a'\nfps = 5", "site 0 has no key 'fps'"),
        (
            "[[site]]\nname = 'a'\ndetections = 'a'\nunit = 'km'",
            "unit of site 0 is 'km', not of m,",
        ),
        ("[[site]]\nname = 'a'\ndetections = 'a'\nframe_rate = '5'", "frame_rate of site 0 is '5'"),
        ("[[site]]\nname = 'a'\ndetections = 'a'\nframe_rate = inf", "frame_rate of site 0 is inf"),
        ("[[site]]\nname = 'a'\ndetections = 'a'\nimage_size = [[1], [2, 3]]", "image_size of"),
        ("[[site]]\nname = 'a'\ndetections = 'a'\nimage_size = [1920, 1080]", "image_size of"),
    ],
)
def test_mistakes_are_named(tmp_path, text, sentence):
    path = tmp_path / "sites.toml"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=sentence) as error:
        read_sites(path)
    assert str(path) in str(error.value)


def test_lists_that_take_long_to_parse_are_refused(tmp_path):
    path = tmp_path / "sites.toml"
    for text, sentence in (
        (".".join(["a"] * 20000) + " = 1", "line 1 has 19999 dots; a list of sites has at most 16"),
        ("#" * 2**20 + "\n", "has 1048577 characters; a list of sites has at most 1048576"),
    ):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=sentence):
            read_sites(path)


def test_the_documented_list_can_be_read(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "long_recordings.md").read_text(encoding="utf-8")
    text = re.search(r"^```toml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)[1]
    (tmp_path / "sites.toml").write_text(text.replace("# image_size", "image_size"))
    (north, south), options = read_sites(tmp_path / "sites.toml")
    assert (len(north.recording), north.scene, south.frame_rate) == (3, None, 5)
    assert south.image_size == ((1920, 1080),) * 2
    assert set(options) == {"every", "overlap", "method", "detector", "embedder"}


def test_paths_may_begin_with_the_home_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    path = tmp_path / "sites.toml"
    path.write_text(
        "detector = '~/a.onnx'\n[[site]]\nname = 'a'\nvideos = ['~/b.mp4', 'c.mp4']\nscene = '~/d'"
    )
    (site,), options = read_sites(path)
    home = tmp_path / "home"
    assert options == {"detector": str(home / "a.onnx")}
    assert site.recording == (str(home / "b.mp4"), str(tmp_path / "c.mp4"))
    assert site.scene == str(home / "d")


def test_a_list_that_is_not_there(tmp_path):
    with pytest.raises(InvalidInputError, match=r"^There is no file .*sites\.toml"):
        read_sites(tmp_path / "sites.toml")


@pytest.fixture(scope="module")
def world():
    return make_world("ring4", frames=60, people=4)


@pytest.fixture(scope="module")
def folder(world, tmp_path_factory):
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    folder = tmp_path_factory.mktemp("recordings")
    write_detections_parquet(folder / "boxes.parquet", world.detections)
    write_scene_json(folder / "scene.json", world.scene)
    return folder


@pytest.fixture
def executor():
    with ThreadPoolExecutor(1) as pool:
        yield pool


def site_in(folder, name="north", **options):
    site = Site(name, str(folder / "boxes.parquet"), scene=str(folder / "scene.json"))
    return dataclasses.replace(site, frame_rate=5.0, **options)


def pictures(folder, width=64):
    """Write ten pictures without people from each of two cameras."""
    cameras = [folder / name for name in "ab"]
    for shade, camera in enumerate(cameras):
        camera.mkdir(parents=True)
        for at in range(10):
            picture = np.full((48, width, 3), 20 * at + shade, np.uint8)
            cv2.imwrite(str(camera / f"{at}.png"), picture)
    return tuple(map(str, cameras))


CUT = {"every": 6.0, "overlap": 3.0}


@pytest.mark.slow
def test_a_site_that_fails_does_not_stop_the_others(folder, executor, tmp_path):
    sites = [
        site_in(folder, "gone", recording=str(folder / "x.parquet")),
        site_in(folder, "unseen", scene=str(folder / "x.json"), date="2026-11-20"),
        site_in(folder),
    ]
    seen = []
    with pytest.raises(ShardError, match="1 of 3 recordings are complete") as caught:
        run_sites(
            sites, out=tmp_path, executor=executor, progress=lambda *step: seen.append(step), **CUT
        )
    assert sorted(reason.split(":")[0] for reason in caught.value.reasons) == ["gone", "unseen"]
    assert all(reason in str(caught.value) for reason in caught.value.reasons)
    (north,) = caught.value.finished
    assert north.folder == tmp_path / "site=north"
    assert len(cf.open_tracks(north.folder)) > 0
    assert seen == [("shards", done, 2) for done in range(3)]


class Fails:
    """A detector without memory."""

    fingerprint = "fails"
    failure = RuntimeError("CUDA out of memory")

    def __call__(self, image):
        raise self.failure


@pytest.mark.slow
def test_a_detector_that_fails_stops_no_site_of_boxes(folder, executor, tmp_path):
    """It may fail in the calibration or in a shard."""
    recording = pictures(tmp_path)
    scene = make_world("ring4", 0, frames=2, people=1).scene
    rig = dataclasses.replace(scene.rig.select([0, 1]), image_size=np.tile([64, 48], (2, 1)))
    sites = [
        site_in(folder, "unknown", recording=recording, scene=None),
        site_in(folder, "known", recording=recording, scene=dataclasses.replace(scene, rig=rig)),
        site_in(folder),
    ]
    with pytest.raises(ShardError, match="1 of 3 recordings are complete") as caught:
        run_sites(sites, out=tmp_path / "out", executor=executor, detector=Fails(), **CUT)
    assert sorted(caught.value.reasons) == [
        "shard 0 of 1 (known): RuntimeError: CUDA out of memory",
        "unknown: calibration: RuntimeError: CUDA out of memory",
    ]
    cause = caught.value.__cause__
    while cause.__cause__ is not None:
        cause = cause.__cause__
    assert cause is Fails.failure


def test_a_calibration_that_a_broken_pool_refuses_is_named(folder, tmp_path):
    class Broken(ThreadPoolExecutor):
        def submit(self, *_, **__):
            raise BrokenExecutor

    site = site_in(folder, scene=None)
    with pytest.raises(ShardError, match="north: calibration: its worker process died"):
        run_sites([site], out=tmp_path, executor=Broken())


@pytest.mark.slow
def test_days_of_one_site_share_its_scene_and_are_tables_of_their_own(folder, executor, tmp_path):
    sites = [site_in(folder, date=day) for day in ("2026-11-20", "2026-11-21")]
    tables = run_sites(sites, out=tmp_path, executor=executor, **CUT)
    assert [table.folder for table in tables] == [
        tmp_path / "site=north" / f"date={site.date}" for site in sites
    ]
    pattern = tmp_path / "site=*" / "date=*" / "part-*.parquet"
    polars = pytest.importorskip("polars", reason="polars is not installed")
    days = polars.scan_parquet(pattern, hive_partitioning=True).collect()["date"]
    assert days.value_counts().sort("date")["count"].to_list() == list(map(len, tables))
    import pyarrow.dataset

    whole = pyarrow.dataset.dataset(tmp_path, format="parquet", partitioning="hive")
    assert whole.count_rows() == sum(map(len, tables)) > 0
    assert {"site", "date"} <= set(whole.schema.names)


@pytest.mark.parametrize("name", ["", "..", "a/b", "a=b", "a" * 101])
def test_names_that_name_no_folder_are_refused_before_anything_is_written(folder, tmp_path, name):
    out = tmp_path / "out"
    for site in (site_in(folder, name, scene=None), site_in(folder, date=name or "/")):
        with pytest.raises(InvalidInputError, match="name"):
            run_sites([site], out=out)
    assert list(tmp_path.iterdir()) == []


def test_each_recording_needs_a_name_and_a_date_of_its_own(folder, tmp_path):
    with pytest.raises(InvalidInputError, match="'north'"):
        run_sites([site_in(folder), site_in(folder)], out=tmp_path)
    with pytest.raises(InvalidInputError, match="no sites"):
        run_sites([], out=tmp_path)


def test_missing_pictures_are_of_cameras_by_their_names_or_numbers(
    world, folder, executor, tmp_path, monkeypatch
):
    given = []

    def keep(recording, *_, silent, **__):
        given.append(silent.tolist())
        raise InvalidInputError("Enough.")

    monkeypatch.setattr(_sites, "shards", keep)
    write_scene_json(tmp_path / "scene.json", world.scene, list("abcd"))
    for camera in ("c", "2"):
        (tmp_path / "missing.csv").write_text(f"frame,camera\n7,{camera}\n")
        site = site_in(folder, scene=str(tmp_path / "scene.json"))
        site = dataclasses.replace(site, silent=str(tmp_path / "missing.csv"))
        with pytest.raises(ShardError, match="Enough"):
            run_sites([site], out=tmp_path / "out", executor=executor, **CUT)
    assert given == [[[7, 2]], [[7, 2]]]


def test_cameras_of_saved_boxes_need_the_size_of_the_images(folder, executor, tmp_path):
    with pytest.raises(ShardError, match="give image_size, or a scene"):
        run_sites([site_in(folder, scene=None)], out=tmp_path, executor=executor, **CUT)


@pytest.fixture
def calibrations(world, monkeypatch):
    """Record the first frame of each calibrated stretch; calibration returns the true scene."""
    tried = []

    def answer(recording, detector, boxes, settings, *, anchors):
        tried.append(boxes.frame.min(initial=1000))
        return world

    monkeypatch.setattr(_sites, "calibrate_cameras", answer)
    return tried


@pytest.mark.slow
def test_a_site_is_calibrated_once(folder, executor, tmp_path, calibrations):
    days = [
        site_in(folder, scene=None, image_size=((1920, 1080),) * 4, date=day)
        for day in ("2026-11-20", "2026-11-21")
    ]
    first = run_sites(days, out=tmp_path, executor=executor, **CUT)
    assert len(calibrations) == 1
    again = run_sites(days, out=tmp_path, executor=executor, **CUT)
    assert len(calibrations) == 1
    assert [table.parts for table in again] == [table.parts for table in first]
    other = cf.Settings(calibration_confidence=0.6)
    run_sites([days[0]], out=tmp_path / "other", settings=other, executor=executor, **CUT)
    assert len(calibrations) == 2


def test_another_date_has_the_scene_of_its_site(folder, tmp_path, calibrations):
    """Until something other than the recording differs."""
    make_world("ring4", 5, frames=20, people=2).detections.save(folder / "tuesday.npz")
    monday = site_in(folder, scene=None, image_size=((1920, 1080),) * 4, date="monday")
    tuesday = dataclasses.replace(monday, recording=str(folder / "tuesday.npz"), date="tuesday")
    silent = dataclasses.replace(tuesday, silent=((3, 1),))
    found = [_sites.calibrate_site(site, tmp_path) for site in (monday, tuesday, silent)]
    assert len(calibrations) == 1
    assert len({scene_text(scene) for scene in found}) == 1
    anchored = dataclasses.replace(tuesday, anchors=(cf.KnownCamera(0, height=4.1),))
    smaller = dataclasses.replace(tuesday, image_size=((1280, 720),) * 4)
    _sites.calibrate_site(anchored, tmp_path)
    _sites.calibrate_site(smaller, tmp_path)
    _sites.calibrate_site(tuesday, tmp_path, cf.Settings(confidence=0.6))
    assert len(calibrations) == 4
    assert len(list((tmp_path / "site=north" / "_calibration").iterdir())) == 4


@pytest.mark.slow
def test_videos_of_other_sizes_are_of_other_cameras(tmp_path, calibrations):
    for day, width in (("monday", 64), ("tuesday", 64), ("wednesday", 80)):
        site = Site("north", pictures(tmp_path / day, width), day, frame_rate=5.0)
        _sites.calibrate_site(site, tmp_path / "out")
    assert len(calibrations) == 2


@pytest.mark.slow
def test_anchors_of_a_site_are_used_once_for_all_its_dates(folder, tmp_path, monkeypatch):
    """Anchors may be a file or in memory; other anchors give another calibration."""
    given = []

    def answer(recording, detector, boxes, settings, *, anchors):
        given.append(anchors)
        raise CalibrationError("that is enough")

    monkeypatch.setattr(_sites, "calibrate_cameras", answer)
    site = site_in(folder, scene=None)
    boxes = dataclasses.replace(
        site, recording=str(folder / "boxes.npz"), image_size=((9, 9),) * 4, frame_rate=5
    )
    make_world("ring4", 0, frames=20, people=2).detections.save(folder / "boxes.npz")
    (folder / "anchors.json").write_text('{"cameras": [{"camera": 0, "height": 4.1}]}')
    known = (cf.KnownCamera(0, height=4.1),)
    for anchors, expected in (
        ((), ()), (known, known), (str(folder / "anchors.json"), known),
    ):  # fmt: skip
        with pytest.raises(CalibrationError, match="that is enough"):
            _sites.calibrate_site(dataclasses.replace(boxes, anchors=anchors), tmp_path)
        assert given[-1] == expected
    days = [
        dataclasses.replace(boxes, anchors=anchors, date=date)
        for anchors, date in ((known, "monday"), ((cf.KnownCamera(0, height=3.0),), "tuesday"))
    ]
    with pytest.raises(InvalidInputError, match="has two lists of anchors"):
        run_sites(days, out=tmp_path)


@pytest.mark.slow
def test_missing_pictures_of_a_site(folder, tmp_path, monkeypatch):
    """Calibration knows the missing pictures, and so do the shards."""
    given, plans = [], []

    def find(recording, *_, **__):
        given.append(set(map(tuple, recording.silent)))
        return make_world("ring4", 0, frames=2, people=2)

    def run(plan, **_):
        plans.append(plan)
        return ()

    monkeypatch.setattr(_sites, "calibrate_cameras", find)
    monkeypatch.setattr(_sites, "run_shards", run)
    detections = make_world("ring4", 0, frames=20, people=4).detections
    missing = ((7, 1), (8, 1), (15, 3))
    gone = np.isin(detections.frame, [7, 8]) & (detections.camera == 1)
    gone |= (detections.frame == 15) & (detections.camera == 3)
    detections[~gone].save(folder / "lacking.npz")
    (folder / "missing.csv").write_text("frame,camera\n7,1\n8,1\n15,3\n")
    site = cf.Site(
        "south", str(folder / "lacking.npz"), image_size=((1920, 1080),) * 4, frame_rate=5
    )
    for silent in (missing, str(folder / "missing.csv"), ()):
        one = dataclasses.replace(site, silent=silent)
        run_sites([one], out=tmp_path / str(len(given)), executor=ThreadPoolExecutor(1))
        assert given[-1] == set(missing if silent else ())
        pictures = [tuple(row) for shard in plans[-1] for row in _sites.silent_pictures(shard)]
        assert sorted(pictures) == sorted(missing if silent else ())
    (folder / "other.csv").write_text("frame,camera\n7,9\n")
    with pytest.raises(ShardError, match=r"south: .*other\.csv"):
        run_sites(
            [dataclasses.replace(site, silent=str(folder / "other.csv"))],
            out=tmp_path / "bad",
            executor=ThreadPoolExecutor(1),
        )


def test_cameras_of_a_site_are_found_as_those_of_a_run_of_boxes(world, tmp_path, monkeypatch):
    """Only confident boxes of instants that all cameras show are used."""
    given = []

    def find(boxes, size, settings, **options):
        given.append((boxes, size, settings, options))
        raise CalibrationError("that is enough")

    monkeypatch.setattr(_stages, "register", find)
    boxes, silent = world.detections, np.array([[7, 1], [30, 0]])
    picture = np.column_stack([boxes.frame, boxes.camera])
    boxes = boxes[~(picture[:, None] == silent).all(-1).any(1)]
    boxes.save(tmp_path / "boxes.npz")
    size, settings = ((1920, 1080),) * 4, cf.Settings(confidence=0.4, calibration_confidence=0.7)
    names = ("C1", "C2", "C3", "C4")
    boxes = dataclasses.replace(boxes, clock=cf.types.Clock(5.0))
    with pytest.raises(CalibrationError, match="that is enough"):
        run_stages(CameraBoxes(boxes, names, np.array(size), silent), settings=settings)
    site = Site(
        "south", str(tmp_path / "boxes.npz"), image_size=size, frame_rate=5.0,
        silent=tuple(map(tuple, silent.tolist())),
    )  # fmt: skip
    with pytest.raises(CalibrationError, match="that is enough"):
        _sites.calibrate_site(site, tmp_path, settings, cf.adapters.BackgroundDetector())
    one, two = given
    assert content_hash(one[0]) == content_hash(two[0])
    assert 0 < len(one[0]) < len(boxes)
    np.testing.assert_array_equal(one[1], two[1])
    assert one[2] == two[2]
    assert one[0].score.min() >= 0.7
    assert one[3]["camera_names"] == two[3]["camera_names"]


def test_other_stretches_are_tried_until_one_suffices(folder, tmp_path, world, monkeypatch):
    monkeypatch.setattr(_sites, "CALIBRATION_SECONDS", 2.0)
    tried = []

    def answer(recording, detector, boxes, settings, *, anchors):
        tried.append(boxes.frame.min() // 10)
        if len(tried) < 3:
            raise CalibrationError("Nobody is there.")
        return world

    monkeypatch.setattr(_sites, "calibrate_cameras", answer)
    site = site_in(folder, scene=None, image_size=((1920, 1080),) * 4)
    found = _sites.calibrate_site(site, tmp_path)
    assert (found.rig.image_size == world.scene.rig.image_size).all()
    assert tried == [3, 1, 4]
    tried.clear()
    monkeypatch.setattr(_sites, "MOST_TRIES", 2)
    with pytest.raises(CalibrationError, match=r"'north'.*Nobody is there"):
        _sites.calibrate_site(site, tmp_path / "b")
    assert len(tried) == 2


@pytest.mark.parametrize("recording", [None, 7])
def test_a_recording_that_is_neither_videos_nor_boxes_is_refused(tmp_path, recording):
    site = cf.Site("a", "boxes.npz")
    object.__setattr__(site, "recording", recording)
    with pytest.raises(InvalidInputError, match="recording of site 'a' must be a list of videos"):
        run_sites([site], out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_site_has_one_scene(tmp_path):
    sites = [cf.Site("north", "a.npz", date, f"{date}.json") for date in ("monday", "tuesday")]
    with pytest.raises(InvalidInputError, match="Site 'north' has two scenes"):
        cf.run_sites(sites, out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_all_dates_of_a_site_have_its_scene_in_its_unit(tmp_path):
    scene = make_world("ring4", 0, frames=2, people=1).true_scene
    path = write_anipose_toml(tmp_path / "c.toml", scene.rig, list("abcd"), metres_per_unit=0.01)
    site = Site("a", "boxes.npz", scene=str(path), unit="cm")
    found, names = _sites._read_scene(str(path), site)
    np.testing.assert_allclose(found.rig.centers, scene.rig.centers, atol=1e-4)
    assert names == tuple("abcd")
    days = [dataclasses.replace(site, date=unit, unit=unit) for unit in ("cm", "mm")]
    with pytest.raises(InvalidInputError, match="has two units"):
        run_sites(days, out=tmp_path)


def test_cameras_of_a_scene_belong_to_the_videos_of_their_name(tmp_path):
    scene = make_world("ring4", 0, frames=2, people=1).scene
    path = write_scene_json(tmp_path / "scene.json", scene, ["north", "east", "south", "west"])
    site = Site("a", ("south.mp4", "west.mp4", "north.mp4", "east.mp4"))
    centers = _sites._read_scene(str(path), site)[0].rig.centers
    np.testing.assert_allclose(centers, scene.rig.centers[[2, 3, 0, 1]], atol=1e-5)
    other = dataclasses.replace(site, recording=("1.mp4", "2.mp4", "3.mp4", "4.mp4"))
    with pytest.raises(InvalidInputError, match=r"names its cameras north, .* videos of 'a' have"):
        _sites._read_scene(str(path), other)
    write_scene_json(path, scene)  # numbered cameras identify nothing
    np.testing.assert_allclose(
        _sites._read_scene(str(path), other)[0].rig.centers, scene.rig.centers, atol=1e-5
    )


@given(day=st.just(["b", "d", "a"]) | st.permutations("abcd").map(lambda names: names[:3]))
def test_all_dates_of_a_site_list_the_same_cameras_in_one_order(tmp_path_factory, day):
    folder = tmp_path_factory.mktemp("site")
    scene = make_world("ring4", 0, frames=2, people=1).scene
    path = write_scene_json(folder / "scene.json", scene, list("abcd"))
    monday = Site("north", ("b.mp4", "d.mp4", "a.mp4"), "monday", scene=str(path))
    recording = tuple(f"{name}.mp4" for name in day)
    sites = [monday, dataclasses.replace(monday, date="tuesday", recording=recording)]
    with ThreadPoolExecutor(1) as pool, pytest.raises(ShardError) as caught:
        run_sites(sites, out=folder, executor=pool)
    swapped = "The videos of north tuesday do not show the same cameras in the same order"
    missing = "north monday"  # its files do not exist
    alike = recording == monday.recording
    assert (swapped not in str(caught.value)) == (missing in str(caught.value)) == alike


def test_boxes_of_a_site_have_the_cameras_of_its_scene(folder, tmp_path, monkeypatch):
    plans = []
    monkeypatch.setattr(_sites, "run_shards", lambda plan, **_: plans.append(plan) or ())
    scene = make_world("ring4", 0, frames=2, people=2).scene
    make_world("ring4", 0, frames=20, people=2).detections.save(folder / "few.npz")
    names = ["north", "east", "south", "west"]
    path = write_scene_json(tmp_path / "scene.json", scene, names)
    site = cf.Site("a", str(folder / "few.npz"), frame_rate=5, scene=str(path))
    run_sites([site], out=tmp_path, executor=ThreadPoolExecutor(1))
    assert {shard.camera_names for shard in plans[0]} == {tuple(names)}
