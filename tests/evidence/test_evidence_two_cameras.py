"""Two cameras are little, but enough: what three would teach is learned from pairs."""

import dataclasses

import numpy as np
import pytest

import catfree as cf
from catfree.evaluation import detection_metrics_in_area
from catfree.evidence import solve
from catfree.geometry import fit_similarity
from catfree.synthetic import DetectorModel, RigError, make_world

WORLD = make_world(
    "ring6",
    5,
    frames=20,
    people=10,
    background=2,
    rig_error=RigError(rotation_deg=0.25),
    detector=DetectorModel(false_positives=0.3),
)


def seen_by(cameras):
    """Boxes and scene of some cameras; the gauge stays that of all."""
    detections, scene = WORLD.detections, WORLD.scene
    own = detections[np.isin(detections.camera, cameras)]
    numbered = {"camera": np.searchsorted(cameras, own.camera)}
    fewer = scene.rig.select(np.array(cameras))
    return (
        cf.Detections(**(vars(own) | numbered)),
        cf.Scene(fewer, scene.ground, scene.extent, scene.metric),
    )


def score(found):
    align = fit_similarity(np.asarray(WORLD.scene.rig.centers), WORLD.true_centres)
    xy = np.asarray(align(found.tracks.position))[:, :2]
    rows = found.tracks.to_rows(xy)
    return detection_metrics_in_area(WORLD.ground_truth, rows, WORLD.area).metrics


@pytest.mark.parametrize("cameras", [(0, 2), (2, 4), (3, 5), (0, 3)])
def test_most_people_are_found_and_more_than_by_the_paper(cameras):
    detections, scene = seen_by(cameras)
    found, paper = (
        score(cf.localize(detections, scene, rules))
        for rules in (cf.Settings(), cf.Settings.paper())
    )
    assert found.precision > 90
    assert found.moda > paper.moda


def test_noise_is_learned_from_two_cameras():
    detections, scene = seen_by((0, 2))
    learned = solve(detections, scene).noise
    start = cf.Settings().evidence
    assert (learned.edge != np.array(start.edge_noise)).any()
    assert learned.density < start.density_start
    fixed = dataclasses.replace(start, self_calibrate=False)
    assert solve(detections, scene, fixed).noise.density == start.density_start
