"""Tables of results with the paper's numbers beside ours, as Markdown and CSV."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from catfree.evaluation import Interval

Cell = str | float | int | Interval | None


@dataclass(frozen=True)
class Table:
    """A table of results.

    Attributes:
        title: content, and the paper's label of the matching table.
        columns: names of the columns.
        rows: one tuple per row, as long as `columns`; None is an empty cell, and an interval is
            shown with its ends.
        notes: sentences below the table.
        verdicts: one sentence per tested claim of the paper.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = field(default=())
    verdicts: Sequence[str] = field(default=())

    def __post_init__(self) -> None:
        """Raise ValueError for a row that does not match the columns."""
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"{self.title}: a row has {len(row)} cells for {len(self.columns)} columns."
                )

    def markdown(self) -> str:
        """Format the table as Markdown, with title, notes and verdicts."""
        lines = [
            f"## {self.title}",
            "",
            "| " + " | ".join(_escaped(name) for name in self.columns) + " |",
            "|" + "---|" * len(self.columns),
            *("| " + " | ".join(_escaped(_text(cell)) for cell in row) + " |" for row in self.rows),
        ]
        if self.notes:
            lines += ["", *(f"- {note}" for note in self.notes)]
        if self.verdicts:
            lines += ["", "**Claims**", "", *(f"- {verdict}" for verdict in self.verdicts)]
        return "\n".join(lines) + "\n"

    def csv(self) -> str:
        """Format the columns and rows as CSV, with unrounded numbers.

        A column with intervals is followed by two columns with their ends, `low` and `high`.
        """
        wide = [
            any(isinstance(row[i], Interval) for row in self.rows) for i in range(len(self.columns))
        ]
        names = []
        for name, ends in zip(self.columns, wide, strict=True):
            names += [name, f"{name} low", f"{name} high"] if ends else [name]
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(names)
        for row in self.rows:
            cells = []
            for cell, ends in zip(row, wide, strict=True):
                if isinstance(cell, Interval):
                    cells += [cell.value, cell.low, cell.high]
                else:
                    cells += ["" if cell is None else cell, *(["", ""] if ends else [])]
            writer.writerow(cells)
        return buffer.getvalue()

    def write(self, folder: Path, name: str) -> None:
        """Write `name.md` and `name.csv` into a folder, which is created if needed."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.md").write_text(self.markdown(), encoding="utf-8")
        (folder / f"{name}.csv").write_text(self.csv(), encoding="utf-8")


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, Interval):
        return f"{cell.value:.1f} [{cell.low:.1f}, {cell.high:.1f}]"
    return f"{cell:.1f}" if isinstance(cell, float) else str(cell)


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
