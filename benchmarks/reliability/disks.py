"""Full disks: each file is complete or absent, and the error is one sentence."""

import contextlib
import os
import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reliability.material import Material
from benchmarks.reliability.tally import Tally
from catfree._run._cache import StageCache
from catfree._run._result_folder import write_results
from catfree._run._run import RunOutcome
from catfree.adapters import write_colmap_text, write_rig_json, write_tracks_csv


def full_disks(tally: Tally, folder: Path, sizes: int) -> None:
    """Write to disks of several sizes.

    Args:
        tally: counts the outcomes.
        folder: an empty folder to work in.
        sizes: number of sizes to try.
    """
    m = Material(0)
    outcome = RunOutcome(m.localization, m.detections, m.scene, None, m.names, np.arange(8))
    writers: dict[str, Callable[[Path], Any]] = {
        "write_results": lambda p: write_results(p / "out", outcome, pictures=False),
        "StageCache.store": lambda p: StageCache(p).store("localize", "0" * 40, m.localization),
        "Scene.save": lambda p: m.scene.save(p / "a.npz"),
        "Rig.save": lambda p: m.rig.save(p / "a.npz"),
        "Detections.save": lambda p: m.detections.save(p / "a.npz"),
        "Tracks.save": lambda p: m.tracks.save(p / "a.npz"),
        "write_rig_json": lambda p: write_rig_json(p / "a.json", m.rig),
        "write_tracks_csv": lambda p: write_tracks_csv(p / "a.csv", m.tracks),
        "write_colmap_text": lambda p: write_colmap_text(p / "a", m.rig, points=np.ones((999, 3))),
    }
    way, disk = _disk_maker(folder)
    whole = folder / "whole"
    for name, write in writers.items():
        shutil.rmtree(whole, ignore_errors=True)
        whole.mkdir()
        write(whole)
        complete = _contents(whole)
        largest = max(map(len, complete.values())) if way != "tmpfs" else _total(complete)
        for at in range(sizes):
            limit = int(largest * (at + 0.5) / sizes)
            with disk(limit) as place:
                row = f"full disk ({way})"
                tally.attempt(row, partial(write, place), detail=f"{name}, {limit} bytes")
                for file, content in _contents(place).items():
                    if complete.get(file) != content:
                        tally.count(row, "loss", f"{name}, {limit} bytes: half of {file}")


def _disk_maker(folder: Path) -> tuple[str, Callable[[int], Any]]:
    """Return a maker of a small tmpfs if mounting is permitted, else of a limit on file sizes."""
    place = folder / "disk"
    place.mkdir()
    probe = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)]
    try:
        mounted = subprocess.run(probe, capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    if mounted:
        subprocess.run(["umount", str(place)], check=True)

    @contextlib.contextmanager
    def tmpfs(limit: int) -> Iterator[Path]:
        # The size of a tmpfs is a number of pages.
        size = max(limit // 4096, 1) * 4096
        options = ["-o", f"size={size}", "tmpfs", str(place)]
        subprocess.run(["mount", "-t", "tmpfs", *options], check=True)
        try:
            yield place
        finally:
            subprocess.run(["umount", str(place)], check=True)

    @contextlib.contextmanager
    def limited(limit: int) -> Iterator[Path]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
        try:
            yield place
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
            shutil.rmtree(place)
            place.mkdir()

    return ("tmpfs", tmpfs) if mounted else ("RLIMIT_FSIZE", limited)


def _contents(folder: Path) -> dict[str, bytes]:
    files = (Path(root) / name for root, _, names in os.walk(folder) for name in names)
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def _total(contents: dict[str, bytes]) -> int:
    return sum(-(-len(content) // 4096) * 4096 for content in contents.values())
