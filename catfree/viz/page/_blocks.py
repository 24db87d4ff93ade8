"""The blocks of a report, as Markdown and as one HTML page."""

import html
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from catfree.adapters.files._documents import write_text_atomically
from catfree.viz.page._player import Player, page_style, player_markup


@dataclass(frozen=True)
class Heading:
    """A heading; level 1 is the title."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """One or more sentences."""

    text: str


@dataclass(frozen=True)
class Table:
    """Rows of text under a header."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Picture:
    """An image file, by its path relative to the report."""

    path: str
    caption: str


@dataclass(frozen=True)
class Video:
    """A video file, by its path relative to the report."""

    path: str
    caption: str


@dataclass(frozen=True)
class Notice:
    """Sentences to be read first, in a frame."""

    title: str
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class Verdicts:
    """Checks: what was checked, its value, and whether it passed; None if that is unknown."""

    rows: tuple[tuple[str, str, bool | None], ...]


@dataclass(frozen=True)
class Folded:
    """Blocks that a page shows on request."""

    title: str
    blocks: tuple["Block", ...]


Block = Heading | Paragraph | Table | Picture | Video | Notice | Verdicts | Folded | Player


def write_blocks(folder: str | os.PathLike[str], blocks: Sequence[Block]) -> list[Path]:
    """Write blocks as `report.md` and `report.html`.

    Args:
        folder: an existing folder for the files.
        blocks: the blocks, in order.

    Returns:
        The two files.
    """
    root = Path(folder)
    return [
        write_text_atomically(root / "report.md", to_markdown(blocks)),
        write_text_atomically(root / "report.html", to_html(blocks)),
    ]


def to_markdown(blocks: Iterable[Block]) -> str:
    """Convert blocks to Markdown, with `<` escaped."""
    return "\n\n".join(_markdown_parts(blocks)).replace("<", "\\<") + "\n"


def _markdown_parts(blocks: Iterable[Block]) -> list[str]:
    parts = []
    for block in blocks:
        match block:
            case Heading(text, level):
                parts.append(f"{'#' * level} {text}")
            case Paragraph(text):
                parts.append(text)
            case Picture(path, caption):
                parts.append(f"![{caption}]({path})")
            case Video(path, caption):
                parts.append(f"[{caption}]({path})")
            case Notice(title, sentences):
                parts += [f"## {title}", *sentences]
            case Folded(title, inner):
                parts += [f"## {title}", *_markdown_parts(inner)]
            case Verdicts(rows):
                checked = tuple((_word(passed), text, value) for text, value, passed in rows)
                parts += _markdown_parts([Table(("verdict", "check", "value"), checked)])
            case Player():
                parts.append("`report.html` plays the plan beside the pictures.")
            case Table(header, rows):
                lines = [header, ("---",) * len(header), *rows]
                cells = ([cell.replace("|", "\\|") for cell in line] for line in lines)
                parts.append("\n".join(f"| {' | '.join(line)} |" for line in cells))
    return parts


def to_html(blocks: Sequence[Block]) -> str:
    """Convert blocks to one HTML page, which needs no network."""
    title = next((b.text for b in blocks if isinstance(b, Heading)), "catfree")
    body = []
    for wide, group in groupby(blocks, _is_wide):
        inner = "".join(_html_parts(group))
        body.append(inner if wide else f'<div class="text">{inner}</div>')
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{page_style()}</style></head>"
        f"<body>{''.join(body)}</body></html>\n"
    )


def _is_wide(block: Block) -> bool:
    """Return whether a block spans the window instead of a column of text."""
    return isinstance(block, Player | Notice) or (isinstance(block, Heading) and block.level == 1)


def _html_parts(blocks: Iterable[Block]) -> list[str]:
    parts = []
    for block in blocks:
        match block:
            case Heading(text, level):
                parts.append(f"<h{level}>{html.escape(text)}</h{level}>")
            case Paragraph(text):
                # The only markup in paragraphs is backquotes around file names.
                pieces = html.escape(text).split("`")
                marked = (f"<code>{p}</code>" if at % 2 else p for at, p in enumerate(pieces))
                parts.append(f"<p>{''.join(marked)}</p>")
            case Picture(path, caption):
                path, caption = html.escape(path), html.escape(caption)
                parts.append(
                    f'<figure><img src="{path}" alt="{caption}" loading="lazy">'
                    f"<figcaption>{caption}</figcaption></figure>"
                )
            case Video(path, caption):
                path, caption = html.escape(path), html.escape(caption)
                parts.append(
                    f'<p><video src="{path}" aria-label="{caption}" controls preload="metadata">'
                    "</video></p>"
                )
            case Notice(title, sentences):
                inner = "".join(_html_parts(Paragraph(sentence) for sentence in sentences))
                # A box that scrolls must be focusable by keyboard.
                parts.append(
                    f'<section class="notice" tabindex="0" aria-label="{html.escape(title)}">'
                    f"<h2>{html.escape(title)}</h2>{inner}</section>"
                )
            case Folded(title, inner):
                folded = "".join(_html_parts(inner))
                title = html.escape(title)
                parts.append(f"<details><summary>{title}</summary>{folded}</details>")
            case Verdicts(rows):
                lines = [
                    f'<tr><td class="{_word(passed)}">{_word(passed)}</td>'
                    f"<td>{html.escape(text)}</td><td>{html.escape(value)}</td></tr>"
                    for text, value, passed in rows
                ]
                parts.append(f"<table>{''.join(lines)}</table>")
            case Player():
                parts.append(player_markup(block))
            case Table(header, rows):
                lines = [_html_row(header, "th"), *(_html_row(row, "td") for row in rows)]
                parts.append(f"<table>{''.join(lines)}</table>")
    return parts


def _word(passed: bool | None) -> str:
    """The verdict in one word."""
    return "unknown" if passed is None else "pass" if passed else "check"


def _html_row(cells: Iterable[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"
