"""What the command line shows: progress on standard error, results on standard output.

Only here are stages named for people and is anything printed, so that the commands read as what
they do.
"""

import contextlib
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from catfree.errors import MissingDependencyError
from catfree.types._progress import Progress

FAILURE, INTERRUPTED = 1, 130

# What the library calls its arguments when it gives advice, and what the command line does.
OPTIONS = {
    "pass on_error='keep'": "give --keep-before-damage",
    "Pass a detector": "Give --detector, a detector",
}
OFFSETS = re.compile(r"pass offsets=\(([-\d, ]+)\)")

# In the order of a run.
STAGE_LABELS = {
    "render": "rendering the world",
    "fit": "learning the background",
    "detect": "detecting people",
    "reconstruction": "reconstructing instants",
    "pairs": "calibrating: pairs of cameras",
    "seeds": "calibrating: first rigs",
    "growth": "calibrating: all cameras",
    "offsets": "calibrating: clocks of cameras",
    "refinement": "refining the cameras",
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
    """The module that reads the words, once everything that the terminal needs is there.

    Raises:
        MissingDependencyError: if tyro or rich is not installed.
    """
    try:
        import rich
        import tyro
    except ImportError as error:
        raise MissingDependencyError(
            "The command line needs tyro and rich: pip install 'catfree[cli]'."
        ) from error
    del rich
    return tyro


@contextlib.contextmanager
def progress_bars() -> Iterator[Progress]:
    """A bar a stage on standard error, with rate and time left."""
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
        """Steps a second."""

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
                # A stage that begins, or begins again, says that those before it are over.
                finish()
                current = stage
            if stage not in tasks:
                tasks[stage] = bars.add_task(STAGE_LABELS.get(stage, stage), total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield progress
        finish()


def print_text(text: str) -> None:
    """A line on standard output; what its encoding cannot show is escaped."""
    encoding = sys.stdout.encoding or "utf-8"
    print(text.encode(encoding, "backslashreplace").decode(encoding))


def print_result(outcome: Any, out: Path) -> None:
    """What a run found, in one sentence, and where to read on."""
    tracks = outcome.localization.tracks
    people = len(np.unique(tracks.track_id))
    registered = int(outcome.scene.rig.registered.sum())
    print_text(
        f"{people} tracks with {len(tracks)} positions in {len(outcome.frames)} frames, from "
        f"{registered} of {len(outcome.camera_names)} cameras. Start with {out / 'report.html'}."
    )


def print_table(table: Any, *, aside: bool = False) -> None:
    """A table of `catfree._run._report`, numbers to the right; `aside` on standard error."""
    from rich.console import Console
    from rich.table import Table

    drawn = Table()
    for at, name in enumerate(table.header):
        drawn.add_column(name, justify="left" if at == 0 else "right")
    for row in table.rows:
        drawn.add_row(*row)
    Console(stderr=aside).print(drawn)


def fail(sentence: str) -> int:
    """Say on standard error what went wrong, in one line; the exit code for it."""
    print(f"catfree: {_in_words_of_the_shell(sentence)}", file=sys.stderr)
    return FAILURE


def warn(warnings: Iterable[str]) -> None:
    """Say on standard error what the reader should know first, one line each."""
    for sentence in warnings:
        print(f"catfree: warning: {_in_words_of_the_shell(sentence)}", file=sys.stderr)


def _in_words_of_the_shell(sentence: str) -> str:
    """A sentence of the library in one line, with the options of the command line."""
    for argument, option in OPTIONS.items():
        sentence = sentence.replace(argument, option)
    sentence = OFFSETS.sub(lambda m: f"give --offsets {m[1].replace(',', '')}", sentence)
    return " ".join(sentence.split())
