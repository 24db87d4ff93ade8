"""Make the reference: one page per package, from the names that it offers, and the commands."""

import contextlib
import inspect
import io
import os
import re
from importlib import import_module
from types import ModuleType

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import catfree as cf
from catfree.cli import main

COMMANDS_PAGE = "command_line.md"
# Packages below those of `catfree` that users may import from.
_DEEPER = (
    "calibration.people", "methods.evidence", "methods.paper.association",
    "methods.paper.trajectories", "synthetic.render",
)  # fmt: skip
_WIDTH = "110"  # characters of a line of help


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages before the navigation is built."""
    for place, names in offered().items():
        file = f"api/{place.removeprefix('catfree.')}.md"
        files.append(File.generated(config, file, content=_page(place, names)))
    files.append(File.generated(config, COMMANDS_PAGE, content=_commands()))
    return files


def offered() -> dict[str, list[str]]:
    """List the public names by package; what several packages offer belongs to the first one."""
    found: dict[str, list[str]] = {}
    seen: set[int] = set()
    for place in _places():
        names = []
        for name in dir(cf) if place is cf else vars(place):
            thing = getattr(place, name)
            if name.startswith("_") or not _belongs(thing, place) or id(thing) in seen:
                continue
            seen.add(id(thing))
            names.append(name)
        if names:
            found[place.__name__] = sorted(names, key=str.lower)
    return found


def _places() -> list[ModuleType]:
    """Packages from the outside in, so that a name stands where users look first."""
    direct = [thing for thing in (getattr(cf, name) for name in dir(cf)) if inspect.ismodule(thing)]
    deeper = [import_module(f"catfree.{name}") for name in _DEEPER]
    return [cf, *(place for place in direct if place.__name__.startswith("catfree.")), *deeper]


def _belongs(thing: object, place: ModuleType) -> bool:
    """Return whether a thing is catfree's, rather than a module or an import of its module."""
    if inspect.ismodule(thing):
        return False
    home = getattr(thing, "__module__", None)
    if not hasattr(place, "__path__"):  # a single module; its functions format messages
        return home == place.__name__ and (inspect.isclass(thing) or place is not cf.errors)
    return home is None or str(home).startswith("catfree")


def _page(place: str, names: list[str]) -> str:
    module = import_module(place)
    summary = (inspect.getdoc(module) or "").splitlines()[0]
    rows = [f"| [`{name}`][{place}.{name}] | {_summary(getattr(module, name))} |" for name in names]
    table = "\n".join(["| name | |", "|---|---|", *rows])
    entries = "\n\n".join(f"::: {place}.{name}" for name in names)
    return f"# {place}\n\n{summary}\n\n{table}\n\n{entries}\n"


def _summary(thing: object) -> str:
    if not (inspect.isclass(thing) or callable(thing)):
        return ""
    return (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ").replace("|", "\\|")


def _commands() -> str:
    """The help of every command, as the terminal prints it."""
    parts = [
        "# The command line",
        "`pip install -e '.[cli]'` in a clone installs the command `catfree`. Its exit code is 0 "
        "only if all went well; otherwise a sentence or two say what to do.",
    ]
    for words in _below(()):
        parts += [f"## catfree {' '.join(words)}", f"```text\n{_help(words)}```"]
    return "\n\n".join(parts) + "\n"


def _below(words: tuple[str, ...]) -> list[tuple[str, ...]]:
    """List the commands that begin with some words, in the order of the help."""
    subcommands = re.match(r"usage: [^{]*\[-h\] \{([\s\w,-]+)\}", _help(words))
    if subcommands is None:
        return [words]
    names = re.sub(r"\s", "", subcommands[1]).split(",")
    return [command for name in names for command in _below((*words, name))]


def _help(words: tuple[str, ...]) -> str:
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = _WIDTH
    try:
        with contextlib.redirect_stdout(io.StringIO()) as stream, contextlib.suppress(SystemExit):
            main([*words, "--help"])
    finally:
        os.environ.pop("COLUMNS")
        if before is not None:
            os.environ["COLUMNS"] = before
    return stream.getvalue()
