"""Output of the command line: progress on standard error, results on standard output.

All printing and all human-readable stage names are in this module.
"""

import contextlib
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from catfree.errors import WriteError, needing

FAILURE, INTERRUPTED = 1, 130
WIDEST = 1000  # columns of a table in a file or pipe, where no line is folded

# Advice in terms of the library, and the same advice in terms of commands and options.
OPTIONS = {
    "pass on_error='keep'": "give --keep-before-damage",
    "pass image_size, or a scene": "give --image-size, or a --scene to catfree localize",
    "undefined. Pass frame_rate": "undefined. Give --frame-rate, or in a file of sites frame_rate",
    "image_size is": "--image-size is",
    "pass its unit to cf.read_scene": "give its --unit",
    "Pass a detector": "Give --detector, a detector",
    "Pass the size (width, height) of": "Give --image-size, the width and height of",
    "one row per camera if they differ": "or COCO files, which state it, if cameras differ",
    "cf.run_shard": "catfree shard",
    "again with cf.shards": "again with catfree plan",
    "cf.viz.plot_heat_map draws it": "The picture is written beside it",
}
OFFSETS = re.compile(r"pass offsets=\(([-\d, ]+)\)")

# In the order of a run.
STAGE_LABELS = {
    "weights": "downloading weights",
    "calibration": "calibrating sites",
    "shards": "tracking people by shards",
    "render": "rendering the world",
    "fit": "learning the background",
    "detect": "detecting people",
    "reconstruction": "reconstructing instants",
    "pairs": "calibrating: pairs of cameras",
    "growth": "calibrating: all cameras",
    "offsets": "calibrating: clocks of cameras",
    "refinement": "refining the cameras",
    "windows": "checking the cameras",
    "changes": "finding what changed",
    "second look": "looking again",
    "self-calibration": "learning the noise of boxes",
    "tracklets": "linking tracklets",
    "association": "associating views",
    "positions": "locating people",
    "selection": "selecting positions",
    "trajectories": "building trajectories",
    "overlay": "drawing the overlay",
}


def require_tyro() -> Any:
    """Import tyro, after checking that rich is installed too.

    Raises:
        MissingDependencyError: if tyro or rich is not installed.
    """
    with needing("The command line needs tyro and rich: pip install 'catfree[cli]'."):
        import rich
        import tyro
    del rich
    return tyro


@contextlib.contextmanager
def progress_bars() -> Iterator[Callable[[str, int, int], None]]:  # `Progress` imports JAX
    """Show one bar per stage on standard error, with rate and time left."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress as Bars,
        ProgressColumn,
        Task,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class RateColumn(ProgressColumn):
        """Show the steps per second."""

        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if speed is None else f"{speed:.1f}/s")

    columns = (
        TextColumn("{task.description:30}"),
        BarColumn(),
        MofNCompleteColumn(),
        RateColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    tasks: dict[str, Any] = {}
    current = ""
    with Bars(*columns, console=Console(stderr=True)) as bars:

        def finish() -> None:
            for task in bars.tasks:
                bars.update(task.id, completed=task.total)

        def progress(stage: str, done: int, total: int) -> None:
            nonlocal current
            if stage != current:
                # When a stage begins, or begins again, all earlier stages have finished.
                finish()
                current = stage
            if stage not in tasks:
                tasks[stage] = bars.add_task(STAGE_LABELS.get(stage, stage), total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield progress
        finish()


def print_text(text: str) -> None:
    """Print a line on standard output at once; escape what its encoding cannot represent."""
    encoding = sys.stdout.encoding or "utf-8"
    with _naming_output():
        print(text.encode(encoding, "backslashreplace").decode(encoding), flush=True)


@contextlib.contextmanager
def _naming_output() -> Iterator[None]:
    """Raise `WriteError` if standard output cannot be written; its `OSError` names no file."""
    try:
        yield
    except BrokenPipeError:  # the reader ended, which is not a failure
        raise
    except OSError as error:
        raise WriteError(f"Standard output: {error.strerror or error}.") from error


def print_result(outcome: Any, out: Path) -> None:
    """Print the warnings of a run, its result in one sentence, and the path of the report."""
    warn(outcome.warnings)
    tracks = outcome.localization.tracks
    people = len(np.unique(tracks.track_id[tracks.track_id >= 0]))
    registered = int(outcome.scene.rig.registered.sum())
    print_text(
        f"{people} tracks with {len(tracks)} positions in {len(outcome.frames)} frames, from "
        f"{registered} of {len(outcome.camera_names)} cameras. The report is {out / 'report.html'}."
    )


def print_table(table: Any, *, aside: bool = False) -> None:
    """Print a table of a report, on standard error if `aside`."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    drawn = Table()
    for at, name in enumerate(table.header):
        one_word = at > 0 and not any(" " in cell for cell in (name, *(r[at] for r in table.rows)))
        justify = "left" if at == 0 else "right"
        drawn.add_column(name, justify=justify, overflow="fold", no_wrap=one_word)
    for row in table.rows:
        drawn.add_row(*map(Text, row))  # literally: names may look like markup
    console = Console(stderr=aside)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = WIDEST
    with contextlib.nullcontext() if aside else _naming_output():
        console.print(drawn)


def fail(sentence: str) -> int:
    """Print one line about a failure on standard error and return the exit code."""
    print(f"catfree: {_for_shell(sentence)}", file=sys.stderr)
    return FAILURE


def warn(warnings: Iterable[str]) -> None:
    """Print warnings on standard error, one line each."""
    for sentence in warnings:
        print(f"catfree: warning: {_for_shell(sentence)}", file=sys.stderr)


def _for_shell(sentence: str) -> str:
    """Put a message of the library on one line and name command-line options in it."""
    for argument, option in OPTIONS.items():
        sentence = sentence.replace(argument, option)
    sentence = OFFSETS.sub(lambda m: f"give --offsets {m[1].replace(',', '')}", sentence)
    return " ".join(sentence.split())
