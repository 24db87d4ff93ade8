"""`python -m benchmarks.reliability` covers every reader; a small part of it finds no failure."""

import dataclasses
import importlib
import inspect
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import catfree

ROOT = Path(__file__).parents[2]

pytest.importorskip("resource", reason="limits of processes are not known to this system")
pytest.importorskip("pyarrow", reason="pyarrow is not installed")
readers = pytest.importorskip("benchmarks.reliability.files").readers
Material = pytest.importorskip("benchmarks.reliability.material").Material
unsound = pytest.importorskip("benchmarks.reliability.tally").unsound


@pytest.mark.slow
def test_every_failure_is_one_sentence():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.reliability", "--short", "--seed", "1"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    parts = ("fuzz", "decay", "attacks", "names of cameras", "kills", "full disk")
    assert all(part in done.stdout for part in parts)


def public_modules():
    for found in pkgutil.walk_packages(catfree.__path__, "catfree."):
        if not any(part.startswith("_") for part in found.name.split(".")):
            yield importlib.import_module(found.name)
    yield catfree


def public_readers():
    """Return the names of all public functions `read_*` and classes' methods `load`."""
    names = set()
    for module in public_modules():
        for name in dir(module):
            item = getattr(module, name)
            if not getattr(item, "__module__", "").startswith("catfree") or name.startswith("_"):
                continue
            if inspect.isclass(item):
                names |= {f"{name}.load"} if hasattr(item, "load") else set()
            elif callable(item) and name.startswith("read_"):
                names.add(name)
    return names


def test_every_public_reader_is_attacked():
    found = public_readers()
    assert found >= {"read_detections", "read_tracks", "read_results", "Rig.load", "Tracks.load"}
    every = [reader.name for reader in readers(0)]
    assert len(set(every)) == len(every)
    assert found - {name.partition(" (")[0] for name in every} == set()


def test_every_file_is_read_before_it_is_damaged(tmp_path):
    for number, reader in enumerate(readers(1)):
        place = tmp_path / str(number)
        place.mkdir()
        reader.write(place)
        value = reader.read(place)
        assert value is not None, reader.name
        assert unsound(value) is None, reader.name


# Values that the types' docstrings call unknown or unlimited.
DOCUMENTED = {
    "candidates": {("sigma", "inf")},
    "reliability": {
        ("median_sigma", "nan"),
        ("median_sigma", "inf"),
        ("sigma_over_radius", "nan"),
        ("expected_precision", "nan"),
        ("expected_recall", "nan"),
        ("expected_moda", "nan"),
        ("ground_height", "nan"),
        ("least_together", "nan"),
    },
    "thresholds": {("extension_appearance", "inf")},
}


@pytest.mark.parametrize("part", DOCUMENTED)
def test_nan_and_infinity_are_faults_where_no_docstring_has_them(part):
    known = Material(0).localization
    assert unsound(known) is None
    owner, excused = getattr(known, part), set()
    for name, held in vars(owner).items():
        if np.asarray(held).dtype.kind != "f":
            continue
        for value in (np.nan, np.inf, -np.inf):
            changed = np.array(held)
            changed.flat[0] = value  # the first candidate has a finite sigma
            changed = changed if changed.ndim else float(changed)
            if unsound(type(owner)(**(vars(owner) | {name: changed}))) is None:
                excused.add((name, str(value)))
    assert excused == DOCUMENTED[part]


def test_unknown_diagnostics_are_excused_only_together():
    known = Material(0).localization
    summary = dataclasses.replace(
        known.reliability, expected_moda=np.nan, moda_low=np.nan, moda_high=np.nan
    )
    assert unsound(summary) is None
    assert (
        unsound(dataclasses.replace(summary, expected_moda=1.0)) == "value.moda_low is not finite"
    )
    infinite = dataclasses.replace(summary, median_sigma=np.inf, sigma_over_radius=np.inf)
    assert unsound(infinite) is None
    assert unsound(dataclasses.replace(infinite, median_sigma=1.0)) is not None
