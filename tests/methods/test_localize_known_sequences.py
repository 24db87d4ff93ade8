"""The paper's method on simulated scenes, against an independent implementation in NumPy."""

import dataclasses
import json
from pathlib import Path

import jax
import pytest

from catfree import Settings
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


def test_float32_and_float64_agree_on_a_scenario(shared):
    whole = sequence_of(shared / "data", "ring5")
    sequence = whole.select_frames(whole.frames[: len(whole.frames) // 3])
    narrow = moda(sequence, localize(sequence))
    with jax.enable_x64(True):
        wide = moda(sequence, localize(sequence))
    assert abs(narrow - wide) <= 0.5
