"""The paper's Table "failure", with fewer samples than the benchmark."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "failure_table.py"
specification = importlib.util.spec_from_file_location("failure_table", SCRIPT)
failure_table = importlib.util.module_from_spec(specification)
specification.loader.exec_module(failure_table)


@pytest.mark.parametrize("separation", failure_table.PAPER)
def test_incorrect_pairs_survive_as_often_as_the_paper_says(separation):
    found = failure_table.survival(separation, samples=100_000, seed=1)
    # Three standard errors of a bin with a ninth of the samples, plus the benchmark's one point.
    np.testing.assert_allclose(found, failure_table.PAPER[separation], atol=2.0)
