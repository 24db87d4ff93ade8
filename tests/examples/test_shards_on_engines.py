"""All executors give the same table: Dask, Ray, and successive processes as on SLURM."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

import catfree as cf

EXAMPLES = Path(__file__).parents[2] / "examples"
OPTIONS = ("--frames", "300", "--every", "20")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run a command in a shared folder."""
    folder = tmp_path_factory.mktemp("engines")
    more = {
        "CATFREE": f"{sys.executable} -m catfree",
        "PYTHONPATH": str(Path(cf.__file__).parents[1]),
        "RAY_AUTH_MODE": "disabled",
    }

    def run(*command):
        done = subprocess.run(
            command, cwd=folder, env=os.environ | more, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run.folder = folder
    return run


@pytest.fixture(scope="module")
def on_dask(run):
    pytest.importorskip("distributed", reason="dask.distributed is not installed")
    said = run(sys.executable, str(EXAMPLES / "shards_on_dask.py"), "--out", "dask", *OPTIONS)
    assert said.startswith("3 shards, ")
    return run.folder / "dask"


def parts_of(folder):
    return {path.name: path.read_bytes() for path in folder.glob("part-*.parquet")}


def test_dask_runs_the_shards(on_dask):
    day = cf.open_tracks(on_dask)
    assert [part.path.name for part in day.parts] == [f"part-{k:05d}.parquet" for k in range(3)]
    assert [(part.first, part.stop) for part in day.parts] == [(0, 100), (100, 200), (200, 300)]
    assert all(part.rows for part in day.parts)
    assert set(day.read().track_id.tolist()) == set(range(day.people))


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="ray is not installed")
def test_ray_writes_the_same_bytes(run, on_dask):
    run(sys.executable, str(EXAMPLES / "shards_on_ray.py"), "--out", "ray", *OPTIONS)
    assert parts_of(run.folder / "ray") == parts_of(on_dask)


@pytest.mark.skipif(sys.platform == "win32", reason="the script is for a POSIX shell")
def test_processes_one_after_another_write_the_same_bytes(run, on_dask):
    boxes, scene = str(on_dask / "_boxes.parquet"), str(on_dask / "_shards" / "scene.json")
    plan = ["--scene", scene, "--frame-rate", "5", "--every", "20", "--overlap", "10"]
    script = str(EXAMPLES / "shards_on_slurm.sh")
    said = run("bash", script, "slurm", boxes, *plan)
    assert "with N from 0 to 2" in said
    assert parts_of(run.folder / "slurm") == parts_of(on_dask)
