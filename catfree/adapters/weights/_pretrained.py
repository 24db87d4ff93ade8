"""A detector or embedder with published weights, by name."""

from typing import Any

from catfree.adapters.detectors._yolox import YoloxOnnx
from catfree.adapters.embedders._reid import ReIdOnnx
from catfree.adapters.weights._fetch_weights import fetch_weights
from catfree.adapters.weights._weights_table import weights_named
from catfree.types._annotations import Progress


def pretrained(
    name: str, *, download: bool = True, progress: Progress | None = None, **options: Any
) -> YoloxOnnx | ReIdOnnx:
    """Make the adapter for published weights, downloading them if they are not on this machine.

    `pretrained("yolox-s")` is a detector and `pretrained("youtu-reid")` an embedder, ready for
    `run`. `WEIGHTS` lists all names with their licenses; `fetch_weights` states where the files are
    kept.

    Args:
        name: one of `WEIGHTS`.
        download: False never connects to the network.
        progress: called as `progress("weights", bytes, total)` while a file is downloaded.
        options: further arguments of the adapter, such as `confidence` or `tiles`.

    Returns:
        `YoloxOnnx` for a detector, `ReIdOnnx` for an embedder.

    Raises:
        CatFreeError: as `fetch_weights` and the adapter.
    """
    adapter = {"detector": YoloxOnnx, "embedder": ReIdOnnx}[weights_named(name).task]
    return adapter(fetch_weights(name, download=download, progress=progress), **options)
