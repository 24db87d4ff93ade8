"""Random damage to valid files of every reader."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reliability.files import readers
from benchmarks.reliability.material import Reader
from benchmarks.reliability.mutations import (
    appended,
    cut,
    damaged,
    doubled,
    flipped,
    swapped,
    truncated,
    zeroed,
)
from benchmarks.reliability.tally import Tally
from catfree._run._cache import content_hash

# Damage by disks, not by writers: a cache must detect all of it.
DECAY = (flipped, truncated, appended, zeroed, cut, doubled, swapped)


def fuzz(tally: Tally, folder: Path, seed: int, each: int) -> None:
    """Damage the input of every reader `each` times and read it.

    Args:
        tally: counts the outcomes.
        folder: an empty folder to work in.
        seed: seed of all random choices.
        each: number of damaged inputs per reader.
    """
    for at, reader in enumerate(readers(seed)):
        place = folder / f"reader_{at}"
        place.mkdir()
        reader.write(place)
        files = [path for path in sorted(place.rglob("*")) if path.is_file()]
        files = [path for path in files if not reader.only or path.suffix in reader.only]
        content = {path: path.read_bytes() for path in files}
        _try(tally, reader, place, "undamaged")
        if tally.rows[f"fuzz {reader.name}"]["valid"] != 1:
            tally.count(f"fuzz {reader.name}", "loss", "the undamaged file is not valid")
        for number in range(each):
            rng = np.random.default_rng([seed, at, number])
            path = files[rng.integers(len(files))]
            path.write_bytes(damaged(content[path], rng))
            _try(tally, reader, place, f"{path.name} by [{seed}, {at}, {number}]")
            path.write_bytes(content[path])
        shutil.rmtree(place)


def decay(tally: Tally, folder: Path, seed: int, each: int) -> None:
    """Damage cache files as disks do: a read must return the written value, or None."""
    for at, reader in enumerate(r for r in readers(seed) if r.cached):
        place = folder / f"cache_{at}"
        place.mkdir()
        reader.write(place)
        (path,) = (path for path in place.iterdir() if path.is_file())
        content, digest = path.read_bytes(), content_hash(reader.read(place))

        def same(value: Any, digest: str = digest) -> bool:
            return content_hash(value) == digest

        for number in range(each):
            rng = np.random.default_rng([seed, 100 + at, number])
            path.write_bytes(DECAY[rng.integers(len(DECAY))](content, rng))
            _try(tally, reader, place, f"[{seed}, {100 + at}, {number}]", same, "decay ")
        shutil.rmtree(place)


def _try(
    tally: Tally, reader: Reader, place: Path, detail: str, same: Any = None, row: str = "fuzz "
) -> None:
    tally.attempt(
        row + reader.name,
        lambda: reader.read(place),
        detail=detail,
        folder=place,
        same=same,
        absent=reader.cached,
    )
