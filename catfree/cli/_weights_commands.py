"""The commands for published weights."""

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import OmitSubcommandPrefixes, Positional, configure, subcommand

from catfree.cli._terminal import print_table, print_text, progress_bars
from catfree.errors import InvalidInputError


@dataclass(frozen=True)
class List:
    """List the weights known by name, with license and address."""


@dataclass(frozen=True)
class Get:
    """Download weights, unless they are on this machine, and print their paths.

    Attributes:
        names: names from `catfree weights list`.
    """

    names: Positional[tuple[str, ...]]


@configure(OmitSubcommandPrefixes)
def weights(
    action: Annotated[List, subcommand("list")] | Annotated[Get, subcommand("get")],
) -> None:
    """List published detectors and embedders, or download them.

    Args:
        action: what to do.
    """
    if isinstance(action, Get):
        _get(action.names)
    else:
        _list()


def _get(names: tuple[str, ...]) -> None:
    from catfree.adapters.weights._fetch_weights import fetch_weights

    if not names:
        raise InvalidInputError("Name the weights to download; `catfree weights list` lists them.")
    for name in names:
        with progress_bars() as progress:
            path = fetch_weights(name, progress=progress)
        print_text(str(path))


def _list() -> None:
    from catfree.adapters.weights._fetch_weights import is_fetched, weights_folder
    from catfree.adapters.weights._weights_table import WEIGHTS
    from catfree.viz.page._blocks import Table

    rows = tuple(
        (w.name, w.description, w.license, f"{w.size / 1e6:.0f} MB", ["no", "yes"][is_fetched(w)])
        for w in WEIGHTS.values()
    )
    print_table(Table(("name", "what", "license", "size", "here"), rows))
    for weights in WEIGHTS.values():
        print_text(f"{weights.name}: {weights.url} (SHA-256 {weights.sha256})")
    print_text(f"Files are kept in {weights_folder()}.")
