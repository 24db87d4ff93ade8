"""The paper's method on simulated scenes, against an independent implementation in NumPy."""

import dataclasses
import json
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import catfree as cf
from catfree import Settings
from catfree.geometry._similarity import Similarity, transform_scene
from tests.known_sequences import (
    PAPER,
    SCENARIOS,
    localize,
    moda,
    of_the_paper,
    sequence_of,
)

pytestmark = pytest.mark.slow


def changed(stage: str, **fields) -> Settings:
    return dataclasses.replace(
        PAPER, **{stage: dataclasses.replace(getattr(PAPER, stage), **fields)}
    )


def expected(data: Path, name: str) -> dict:
    path = data / "scenarios" / f"public_{name}" / "expected.json"
    return json.loads(path.read_text())["oracle"]


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_reach_the_reference(shared, name):
    sequence = sequence_of(shared / "data", name)
    found = of_the_paper(shared / "data", name)
    assert moda(sequence, found) >= expected(shared / "data", name)["full"]["moda"] - 1.0


@pytest.mark.parametrize(
    ("variant", "settings"),
    [
        ("no_gate", changed("selection", gates="none")),
        ("Q", changed("selection", gates="support")),
        ("unc_only", changed("selection", gates="uncertainty_replace")),
        ("ground_then_unc", changed("selection", gates="ground_then_uncertainty_replace")),
        ("no_traj", changed("trajectories", enabled=False)),
        ("no_extension", changed("trajectories", extend=False)),
        ("constrained", changed("triangulation", constrain_to_ground=True)),
        ("baseline_B", changed("triangulation", estimator="best_pair")),
    ],
)
def test_ablations_land_where_the_reference_does(shared, variant, settings):
    sequence = sequence_of(shared / "data", "ring5")
    found = localize(sequence, settings)
    wanted = expected(shared / "data", "ring5")[variant]["moda"]
    assert abs(moda(sequence, found) - wanted) <= 3.0


def test_a_whole_scenario_moves_with_its_scene(shared, x64):
    whole = sequence_of(shared / "data", "ring5")
    sequence = whole.select_frames(whole.frames[: len(whole.frames) // 3])
    assert sequence.scene is not None
    extent = float(sequence.scene.extent)
    rng = np.random.default_rng(0)
    rotation = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    similarity = Similarity(7.0, rotation, 50 * extent * rng.standard_normal(3))
    scene = transform_scene(similarity, sequence.scene)
    cameras = rng.permutation(scene.rig.camera_count)
    rows = rng.permutation(len(sequence.detections))
    mixed = vars(sequence.detections[rows])
    detections = cf.Detections(**(mixed | {"camera": np.argsort(cameras)[mixed["camera"]]}))
    mixed_scene = cf.Scene(scene.rig.select(cameras), scene.ground, scene.extent)
    wanted = localize(sequence).tracks
    found = cf.localize(detections, mixed_scene, PAPER).tracks
    moved = np.asarray(similarity(wanted.position))
    agree, together, partner = 0, 0, {}
    for frame in np.unique(wanted.frame):
        mine, other = wanted.frame == frame, np.flatnonzero(found.frame == frame)
        distance = np.linalg.norm(moved[mine][:, None] - found.position[other][None], axis=-1)
        close = distance.min(1, initial=np.inf) <= 1e-5 * 7.0 * extent
        agree += close.sum()
        names = found.track_id[other[distance.argmin(1)]]
        for one, two in zip(wanted.track_id[mine][close], names[close], strict=True):
            together += partner.setdefault(int(one), int(two)) == int(two)
    assert abs(len(found) - len(wanted)) <= 0.005 * len(wanted)
    assert agree >= 0.995 * len(wanted)
    assert together >= 0.995 * agree


def test_float32_and_float64_agree_on_a_scenario(shared):
    whole = sequence_of(shared / "data", "ring5")
    sequence = whole.select_frames(whole.frames[: len(whole.frames) // 3])
    narrow = moda(sequence, localize(sequence))
    with jax.enable_x64(True):
        wide = moda(sequence, localize(sequence))
    assert abs(narrow - wide) <= 0.5
