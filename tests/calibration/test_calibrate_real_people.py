"""Rigs of real scenes from real detector boxes, against their surveyed calibration."""

import dataclasses
from importlib import import_module

import numpy as np
import pytest

from catfree.adapters import read_uniform_json
from catfree.calibration import calibrate
from catfree.calibration.people import register
from catfree.geometry import fit_similarity


def compare(path, frames=slice(None), calibrate=calibrate):
    """Of what is calibrated from some frames: see `errors`."""
    sequence = read_uniform_json(path)
    detections = sequence.detections
    detections = detections[np.isin(detections.frame, np.unique(detections.frame)[frames])]
    return errors(calibrate(detections, sequence.rig.image_size), sequence.rig)


def errors(calibration, truth):
    """Registered cameras, mean centre error after similarity in metres, scale and its sd."""
    found = calibration.scene.rig
    known = found.registered
    ours, theirs = np.asarray(found.centers)[known], np.asarray(truth.centers)[known]
    similarity = fit_similarity(ours, theirs)
    error = np.linalg.norm(np.asarray(similarity(ours)) - theirs, axis=-1)
    return int(known.sum()), error.mean(), 1 / float(similarity.scale), calibration.scale_sd


@pytest.mark.parametrize(("name", "limit"), [("cmc1", 0.16), ("cmc3", 0.08)])
def test_a_real_room(shared, name, limit):
    count, error, scale, deviation = compare(
        shared / "data" / "real" / f"{name}.json", calibrate=register
    )
    assert count == 4
    assert error <= limit
    assert abs(scale - 1) < 2 * deviation


@pytest.mark.slow
@pytest.mark.parametrize("frames", [slice(None), slice(72)], ids=str)
def test_a_real_square_by_registration_and_then_with_the_evidence_method(
    shared, monkeypatch, frames
):
    registered = []

    def remember(*arguments, **options):
        registered.append(register(*arguments, **options))
        return registered[-1]

    monkeypatch.setattr(import_module("catfree.calibration._calibrate"), "register", remember)
    path = shared / "data" / "real" / "wildtrack_0_715.json"
    count, error, scale, deviation = compare(path, frames)
    assert count == 7
    assert error <= 0.16
    assert abs(scale - 1) < 0.03 < deviation < 0.06
    count, error, scale, deviation = errors(registered[0], read_uniform_json(path).rig)
    assert count == 7
    assert error <= 0.30
    assert abs(scale - 1) < 0.04
    assert deviation < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("frames", [slice(36, 107), slice(47, 94)], ids=str)
def test_a_camera_that_settled_beside_its_place_is_found(shared, frames):
    path = shared / "data" / "real" / "wildtrack_0_715.json"
    count, error, scale, deviation = compare(path, frames)
    assert count == 7
    assert error <= 0.20
    assert abs(scale - 1) < deviation


def errors_without(boxes, truth, wrong, times):
    """Centre errors after similarity with one camera's frames at other times: it is flagged."""
    frame = boxes.frame.copy()
    mine = boxes.camera == wrong
    frame[mine] = times[np.searchsorted(np.unique(boxes.frame), frame[mine])]
    found = calibrate(dataclasses.replace(boxes, frame=frame), truth.image_size).scene.rig
    known = found.registered
    assert known.tolist() == [camera != wrong for camera in range(len(known))]
    ours, theirs = np.asarray(found.centers)[known], np.asarray(truth.centers)[known]
    moved = np.asarray(fit_similarity(ours, theirs)(ours))
    return np.linalg.norm(moved - theirs, axis=-1)


@pytest.mark.slow
def test_a_camera_of_another_time_is_flagged_and_the_others_stay(shared):
    sequence = read_uniform_json(shared / "data" / "real" / "wildtrack_0_715.json")
    boxes, truth, wrong = sequence.detections, sequence.rig, 2
    shuffled = np.random.default_rng(0).permutation(np.unique(boxes.frame))
    assert errors_without(boxes, truth, wrong, shuffled).mean() <= 0.24


@pytest.mark.parametrize(("name", "wrong"), [("cmc1", 0), ("cmc1 FairMOT", 3)])
def test_a_camera_that_is_late_is_flagged_though_people_walk_to_and_fro(shared, name, wrong):
    """Of the same few people in the same room, its matches 5 s late beat every other lateness."""
    path = shared / "data" / "real" / f"{name.split()[0]}.json"
    views = "views_fairmot" if "FairMOT" in name else "views"
    sequence = read_uniform_json(path, views=views)
    boxes, truth = sequence.detections, sequence.rig
    late = np.roll(np.unique(boxes.frame), -20)
    assert errors_without(boxes, truth, wrong, late).max() <= 0.16
