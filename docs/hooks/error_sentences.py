"""Fill in the page of errors: every sentence that catfree raises, read from its source."""

import ast
import html
import inspect
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import catfree as cf
from catfree import errors

MARK = "<!-- every sentence -->"
SOURCE = Path(cf.__file__).parent
RAISES = {"needing": "MissingDependencyError"}  # functions that raise the sentence they are given


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace the mark on the page of errors."""
    return markdown.replace(MARK, _listing()) if MARK in markdown else markdown


@cache
def sentences() -> dict[str, list[str]]:
    """List the messages of each class of error, with `…` where values stand."""
    found: dict[str, list[str]] = {name: [] for name in error_classes()}
    for node in _nodes():
        if isinstance(node, ast.Call) and node.args and isinstance(node.func, ast.Name):
            text = _text(node.args[0])
            kept = found.get(RAISES.get(node.func.id, node.func.id))
            if kept is not None and re.search(r"\w{3}.*\s\w", text) and text not in kept:
                kept.append(text)
    return {name: sorted(texts, key=str.lower) for name, texts in found.items() if texts}


@cache
def texts() -> str:
    """Return all texts of the source, among them all errors and warnings, one per line."""
    return "\n".join(_text(node) for node in _nodes() if _text(node))


def error_classes() -> list[str]:
    """Names of the classes, in the order of `catfree.errors`."""
    return [
        name
        for name, thing in vars(errors).items()
        if inspect.isclass(thing) and issubclass(thing, errors.CatFreeError)
    ]


def _nodes() -> Iterator[ast.AST]:
    for path in sorted(SOURCE.rglob("*.py")):
        yield from ast.walk(ast.parse(path.read_text("utf-8")))


def _text(node: ast.AST) -> str:
    match node:
        case ast.Constant(value=str(value)):
            return value
        case ast.JoinedStr(values=parts):
            return "".join(_text(part) or "…" for part in parts)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return (_text(left) or "…") + (_text(right) or "…")
    return ""


def _listing() -> str:
    parts = []
    for name, listed in sentences().items():
        document = inspect.getdoc(getattr(errors, name)) or ""
        rows = "\n".join(f"<li>{html.escape(sentence)}</li>" for sentence in listed)
        parts.append(
            f"### {name}\n\n{document.splitlines()[0]}\n\n<details>\n"
            f"<summary>{len(listed)} sentences</summary>\n<ul>\n{rows}\n</ul>\n</details>"
        )
    return "\n\n".join(parts)
