"""Two cameras suffice: parameters usually learned from three cameras are learned from pairs."""

import dataclasses

import numpy as np
import pytest

import catfree as cf
from catfree.evaluation import detection_metrics_in_area
from catfree.geometry import fit_similarity
from catfree.methods.evidence import solve
from catfree.methods.evidence.learn import _self_calibration
from catfree.settings import EvidenceSettings
from catfree.synthetic import DetectorModel, RigError, make_world

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def world():
    return make_world(
        "ring6",
        5,
        frames=20,
        people=10,
        background=2,
        rig_error=RigError(rotation_deg=0.25),
        detector=DetectorModel(false_positives=0.3),
    )


EVERYWHERE = cf.Settings(evidence=EvidenceSettings(working_area=False))


def seen_by(world, cameras):
    """Select boxes and scene of some cameras, keeping the gauge of all."""
    detections, scene = world.detections, world.scene
    own = detections[np.isin(detections.camera, cameras)]
    numbered = {"camera": np.searchsorted(cameras, own.camera)}
    fewer = scene.rig.select(np.array(cameras))
    return (
        cf.Detections(**(vars(own) | numbered)),
        cf.Scene(fewer, scene.ground, scene.extent, scene.metric),
    )


def score(world, cameras, rules=EVERYWHERE):
    """Compute metrics in the area for results with some cameras."""
    found = cf.localize(*seen_by(world, cameras), rules)
    align = fit_similarity(np.asarray(world.scene.rig.centers), world.true_centres)
    xy = np.asarray(align(found.tracks.position))[:, :2]
    rows = found.tracks.to_rows(xy)
    return detection_metrics_in_area(world.ground_truth, rows, world.area).metrics


@pytest.fixture(scope="module")
def by_all(world):
    return score(world, range(6))


@pytest.mark.parametrize("cameras", [(0, 2), (2, 4), (3, 5), (0, 3)])
def test_more_people_are_found_than_by_the_paper_and_no_more_than_by_all_cameras(
    world, by_all, cameras
):
    found, paper = score(world, cameras), score(world, cameras, cf.Settings.paper())
    assert by_all.tp >= found.tp > paper.tp
    assert by_all.moda >= found.moda > paper.moda


def test_crowding_is_learned_from_pairs(world):
    detections, scene = seen_by(world, (0, 2))
    rules = cf.Settings().evidence
    fixed = dataclasses.replace(rules, self_calibrate=False)
    assert solve(detections, scene, fixed).noise.density == rules.density_start
    # Twelve people in 16 by 16 meters, in cells of 2 by 2 heights that anyone visits.
    assert 0.02 < solve(detections, scene).noise.density < 0.2


def test_what_separates_two_cameras_is_shared_and_stays_so(world, monkeypatch):
    detections, scene = seen_by(world, (0, 2))
    fields = []
    for rounds in (6, 7):
        monkeypatch.setattr(_self_calibration, "ROUNDS", rounds)
        fields.append(solve(detections, scene).noise.field)
    assert np.abs(fields[0]).max() > 5e-3
    assert np.abs(fields[1] - fields[0]).max() < 0.25 * np.abs(fields[0]).max()
