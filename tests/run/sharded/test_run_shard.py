"""Shards run once, record their inputs, and together find the people that one run finds."""

import dataclasses
import errno
import os
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import catfree as cf
from catfree._run.sharded import _run_shard as module
from catfree._run.sharded._receipt import SCHEMA, files_of
from catfree._run.sharded._run_shard import run_fingerprint
from catfree.errors import (
    FileFormatError,
    InvalidInputError,
    MissingDependencyError,
    WriteError,
)
from catfree.settings import EvidenceSettings
from catfree.synthetic import DetectorModel, make_world
from catfree.types import Detections
from catfree.types._archive import load_arrays

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def world():
    """Simulate half a minute with six well-seen people."""
    model = DetectorModel(embedding_size=8, false_positives=0.1)
    return make_world("ring4", 1, frames=160, people=6, detector=model)


@pytest.fixture(scope="module")
def plan(world):
    return cf.shards(world.detections, every=16, overlap=8, frame_rate=5)


# In half a minute, a few rows affect the usual number of images of a whole person, and hence the
# border of the working area.
EVERYWHERE = cf.Settings(evidence=EvidenceSettings(working_area=False))


@pytest.fixture(scope="module")
def out(world, plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("day")
    for shard in plan:
        cf.run_shard(shard, scene=world.true_scene, out=folder, settings=EVERYWHERE)
    return folder


def test_shards_find_the_people_that_one_run_finds(world, out):
    whole = cf.localize(world.detections, world.true_scene, EVERYWHERE).tracks
    joined = cf.join(out)
    rows = [cf.evaluation.crop(t.to_rows(), world.area) for t in (whole, joined)]
    frames = np.arange(160)
    same = cf.evaluation.tracking_metrics(rows[0], rows[1], frames, 0.3)
    assert same.idf1 > 90
    assert same.motp < 0.02
    scores = [cf.evaluation.detection_metrics(world.ground_truth, r, frames).moda for r in rows]
    assert abs(scores[0] - scores[1]) < 3


def test_a_finished_shard_is_not_run_again(world, plan, out, monkeypatch):
    options = {"scene": world.true_scene, "out": out, "settings": EVERYWHERE}
    receipts = [cf.run_shard(shard, **options) for shard in plan]

    def never(*arguments, **options):
        raise AssertionError("it ran again")

    monkeypatch.setattr(module, "localize_people", never)
    assert [cf.run_shard(shard, **options) for shard in plan] == receipts
    for receipt, shard in zip(receipts, plan, strict=True):
        assert receipt.boxes == len(shard.detections)
        assert 0.3 < receipt.boxes_used <= 1
    for settings in (cf.Settings(), cf.Settings.paper()):
        with pytest.raises(AssertionError, match="it ran again"):
            cf.run_shard(plan[0], scene=world.true_scene, out=out, settings=settings)


@pytest.mark.parametrize("what", ["receipt", "part", "fragments"])
def test_a_damaged_shard_runs_again(world, plan, tmp_path, what, monkeypatch):
    runs = []

    def counted(shard):
        runs.append(shard)
        return shard.detections[:0]  # no people: fast

    monkeypatch.setattr(module, "boxes_of_shard", counted)
    for expected in (1, 1, 2):
        if expected == 2:
            path = getattr(files_of(tmp_path, plan[0].index), what)
            path.write_bytes(path.read_bytes()[:-20])
        cf.run_shard(plan[0], scene=world.true_scene, out=tmp_path)
        assert len(runs) == expected


@pytest.mark.parametrize("which", range(4))
def test_a_full_disk_is_said_and_loses_no_finished_shard(world, plan, tmp_path, which, monkeypatch):
    monkeypatch.setattr(module, "boxes_of_shard", lambda shard: shard.detections[:0])
    options = {"scene": world.true_scene, "out": tmp_path}
    cf.run_shard(plan[0], **options)
    files, real, writes = files_of(tmp_path, plan[1].index), os.replace, []

    def full(source, target):
        writes.append(target)
        if len(writes) > which:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(source, target)

    if which < 3:
        monkeypatch.setattr(os, "replace", full)
        with pytest.raises(WriteError, match="No space left on device"):
            cf.run_shard(plan[1], **options)
        monkeypatch.setattr(os, "replace", real)
        assert not files.receipt.exists()
        assert not list(tmp_path.rglob(".catfree-*"))
    cf.run_shard(plan[1], **options)
    assert len(cf.join(tmp_path)) == 0


def test_a_shard_keeps_one_appearance_vector_per_track(world, plan, out):
    size = world.detections.embedding.shape[1]
    for shard in plan:
        kept = load_arrays(files_of(out, shard.index).fragments, "ShardSummary", required=None)
        tracks = len(kept["fragments.identity"])
        assert tracks > 0
        shapes = [array.shape for array in kept.values() if size in np.shape(array)[1:]]
        assert shapes == [(tracks, size)]


def test_a_folder_holds_one_scene(world, plan, out):
    other = dataclasses.replace(world.true_scene, extent=np.asarray(3.0))
    with pytest.raises(InvalidInputError, match=r"holds shards of another scene .*Name another"):
        cf.run_shard(plan[0], scene=other, out=out)


def test_settings_scene_and_code_change_the_fingerprint(world):
    scene = world.true_scene
    other = dataclasses.replace(scene, extent=np.asarray(3.0))
    made = [run_fingerprint(scene, cf.Settings()), run_fingerprint(other, cf.Settings())]
    made += [run_fingerprint(scene, EVERYWHERE), run_fingerprint(scene, cf.Settings(), Named("a"))]
    made += [run_fingerprint(scene, cf.Settings(), None, Named("a"))]
    assert len(set(made)) == 5


class Named:
    """A detector whose name alone matters."""

    def __init__(self, fingerprint):
        self.fingerprint = fingerprint


def test_cameras_that_failed_take_nobody_with_them(world, tmp_path):
    """Missing pictures are not evidence, in a shard as in `localize`."""
    boxes = world.detections
    failed = boxes[(boxes.camera > 1) | (boxes.frame < 80)]
    silent = [[frame, camera] for frame in range(80, 160) for camera in (0, 1)]
    (shard,) = cf.shards(failed, every=100, overlap=8, frame_rate=5, silent=silent)
    cf.run_shard(shard, scene=world.true_scene, out=tmp_path, settings=EVERYWHERE)
    alone = cf.localize(failed, world.true_scene, EVERYWHERE, silent=silent).tracks
    np.testing.assert_allclose(cf.join(tmp_path).position, alone.position, atol=1e-6)
    assert len(alone) > len(cf.localize(failed, world.true_scene, EVERYWHERE).tracks)


def test_boxes_need_no_detector(world, plan, tmp_path):
    detector = cf.adapters.BackgroundDetector()
    with pytest.raises(InvalidInputError, match="consists of boxes"):
        cf.run_shard(plan[0], scene=world.true_scene, out=tmp_path, detector=detector)


def test_without_pyarrow_nothing_is_computed(world, plan, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingDependencyError, match="pyarrow"):
        cf.run_shard(plan[0], scene=world.true_scene, out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_boxes_of_an_unknown_camera_are_refused(world, tmp_path):
    boxes = Detections([0, 1], [0, 9], np.tile([0.0, 0, 10, 30], (2, 1)))
    (shard,) = cf.shards(boxes, frame_rate=5)
    with pytest.raises(InvalidInputError, match="camera"):
        cf.run_shard(shard, scene=world.true_scene, out=tmp_path)
    assert not list(tmp_path.glob("_shards/part-*"))


def test_an_empty_shard_is_a_shard(world, tmp_path):
    """There are no people between the first and the last minute."""
    boxes = world.detections[world.detections.frame < 5]
    late = Detections(boxes.frame + 600, boxes.camera, boxes.box, score=boxes.score)
    both = Detections(
        np.r_[boxes.frame, late.frame], np.r_[boxes.camera, late.camera],
        np.r_[boxes.box, late.box], score=np.r_[boxes.score, late.score],
    )  # fmt: skip
    plan = cf.shards(both, every=30, overlap=4, frame_rate=5)
    receipts = [cf.run_shard(shard, scene=world.true_scene, out=tmp_path) for shard in plan]
    assert [receipt.boxes > 0 for receipt in receipts] == [True, False, False, True]
    joined = cf.join(tmp_path)
    assert not ((joined.frame > 5) & (joined.frame < 600)).any()


def test_nobody_tells_how_long_an_appearance_vector_is(world, plan, tmp_path):
    nobody = Detections([], [], np.zeros((0, 4)), embedding=np.zeros((0, 0)))
    for shard in plan:
        empty = dataclasses.replace(shard, detections=nobody)
        cf.run_shard(empty, scene=world.true_scene, out=tmp_path)
    assert len(cf.join(tmp_path)) == 0


@pytest.mark.parametrize(("names", "shown"), [(list("abcd"), "'b'"), (None, "1")])
def test_sentences_name_cameras_of_boxes(world, tmp_path, monkeypatch, names, shown):
    moved = SimpleNamespace(camera=1, verdict=cf.Verdict.MOVED, advice="Calibrate again.")
    monkeypatch.setattr(module, "check", lambda *_, **__: SimpleNamespace(cameras=[moved]))
    given, real = [], module.localize_people
    monkeypatch.setattr(
        module,
        "localize_people",
        lambda *some, camera_names, **more: given.append(camera_names) or real(*some, **more),
    )
    (shard,) = cf.shards(world.detections, frame_rate=5, camera_names=names)
    shard = dataclasses.replace(shard, detections=world.detections[:0])  # no people: fast
    receipt = cf.run_shard(shard, scene=world.true_scene, out=tmp_path)
    assert f"Camera {shown} is moved. Calibrate again." in receipt.warnings
    assert given == [None if names is None else tuple(names)]


def test_a_receipt_of_another_version_is_refused_by_name(plan, world, tmp_path):
    cf.run_shard(plan[0], scene=world.true_scene, out=tmp_path)
    path = files_of(tmp_path, 0).receipt
    path.write_text(path.read_text().replace(SCHEMA, "catfree shards 0"))
    with pytest.raises(FileFormatError, match=r"part-00000.json is a receipt of another version"):
        cf.join(tmp_path)
