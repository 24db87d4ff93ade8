"""The command line shared by all table modules."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.paper.table import Table


@dataclass(frozen=True)
class Options:
    """Input of a table.

    Attributes:
        data: folder with `real/` and `scenarios/`, or None.
        seeds: seeds of the twins; their frames are pooled.
        frames: frames of each twin, or None for the paper's number.
    """

    data: Path | None = None
    seeds: tuple[int, ...] = (0, 1, 2)
    frames: int | None = None


def parse(description: str) -> tuple[Options, Path | None]:
    """Read `--data`, `--seeds`, `--frames` and `--out` from the command line."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder with real/ and scenarios/")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="of the twins")
    parser.add_argument("--frames", type=int, help="of each twin, instead of the paper's number")
    parser.add_argument("--out", type=Path, help="folder for .md and .csv files")
    given = parser.parse_args()
    return Options(given.data, tuple(given.seeds), given.frames), given.out


def main(table: Callable[[Options], Table], name: str, description: str) -> None:
    """Make one table, print it, and write it to the folder given by `--out`."""
    options, out = parse(description)
    made = table(options)
    print(made.markdown(), flush=True)
    if out is not None:
        made.write(out, name)
