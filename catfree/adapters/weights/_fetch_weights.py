"""Published weights on this machine: found, checked, and downloaded on request."""

import os
from pathlib import Path
from typing import Any

from catfree.adapters.files._fingerprint import hash_file
from catfree.adapters.weights._weights_table import Weights, weights_named
from catfree.errors import DownloadError, InvalidInputError, needing, quoted
from catfree.types._annotations import Progress
from catfree.types._writing import make_folder, replacement

FOLDER_VARIABLE = "CATFREE_WEIGHTS"
_TIMEOUT = 30.0  # seconds without a byte
_CHUNK = 1 << 18


def fetch_weights(name: str, *, download: bool = True, progress: Progress | None = None) -> Path:
    """Return the path of a published file, downloading it if it is not on this machine.

    Files are kept in the folder that the environment variable `CATFREE_WEIGHTS` names, or else in
    the user's cache folder (`~/.cache/catfree/weights` on Linux). Their SHA-256 is checked each
    time. A download that fails leaves no file behind.

    Args:
        name: one of `WEIGHTS`.
        download: False never connects to the network.
        progress: called as `progress("weights", bytes, total)`.

    Returns:
        The ONNX file.

    Raises:
        InvalidInputError: if there is no such name, or the right file is not on this machine and
            `download` is False.
        DownloadError: if the file cannot be downloaded or is not the published one; the message
            states which file to fetch by hand and where to put it.
        MissingDependencyError: if pooch is not installed.
        WriteError: if the folder is not writable or the disk is full.
    """
    weights = weights_named(name)
    path = weights_folder() / weights.file_name
    if is_fetched(weights):
        return path
    if not download:
        state = "is not the published file" if path.is_file() else "does not exist"
        raise InvalidInputError(
            f"The weights {name} are not on this machine ({path} {state}): run `catfree weights "
            f"get {name}`, or fetch {weights.url} by hand and put it there."
        )
    pooch = _require_pooch()
    make_folder(path.parent)
    bar = _Bar(progress) if progress is not None else False
    downloader = pooch.HTTPDownloader(progressbar=bar, timeout=_TIMEOUT, chunk_size=_CHUNK)
    with replacement(path) as partial:
        try:
            downloader(weights.url, str(partial), None)
        except OSError as error:
            # Network errors come from requests, disk errors from the operating system.
            if not type(error).__module__.startswith("requests"):
                raise
            raise _failed(weights, path, quoted(error)) from error
        if hash_file(partial) != weights.sha256:
            raise _failed(weights, path, "the download is not the published file")
    return path


def is_fetched(weights: Weights) -> bool:
    """Return whether the published file is on this machine, unchanged."""
    path = weights_folder() / weights.file_name
    return path.is_file() and hash_file(path) == weights.sha256


def weights_folder() -> Path:
    """Find the folder of the files; it need not exist.

    Raises:
        MissingDependencyError: if pooch, which knows the system's cache folder, is not installed
            and the environment names no folder.
    """
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else Path(_require_pooch().os_cache("catfree")) / "weights"


def _failed(weights: Weights, path: Path, reason: str) -> DownloadError:
    return DownloadError(
        f"The weights {weights.name} could not be downloaded ({reason}): fetch {weights.url} by "
        f"hand and put it at {path}."
    )


def _require_pooch() -> Any:
    with needing("Weights by name need pooch: pip install 'catfree[weights]'."):
        import pooch
    return pooch


class _Bar:
    """The part of a progress bar that pooch calls."""

    total = 0  # pooch sets it when the server has answered

    def __init__(self, progress: Progress) -> None:
        self.progress, self._done = progress, 0

    def update(self, count: int) -> None:
        self._done = min(self._done + count, self.total)
        self.progress("weights", self._done, self.total)

    def reset(self) -> None:
        self._done = 0

    def close(self) -> None:
        pass
