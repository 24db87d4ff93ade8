"""Cache stage results on disk, keyed by the content that they are computed from."""

import dataclasses
import functools
import hashlib
import os
import types
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from catfree.adapters.files._fingerprint import hash_parameters
from catfree.errors import FileFormatError, InvalidInputError, WriteError
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._archive import arguments_of, load_arrays, naming_file, save_arrays
from catfree.types._validation import options_of, require_declared_types
from catfree.types._writing import cannot_write, make_folder, remove_abandoned
from catfree.types.results._localization import require_sound_localization

T = TypeVar("T")
Arrays = dict[str, Any]

SEPARATOR = "."


class StageCache:
    """A folder of results, one file per result, named by stage and content key.

    Files are written completely or not at all, and named by a key of their inputs: a killed run
    keeps its finished stages, concurrent runs write identical files, and a run with other videos,
    weights, settings or code does not reuse them. A damaged file counts as absent.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        """Create the folder if it does not exist and remove partial files of killed runs.

        Raises:
            WriteError: if the folder cannot be created.
        """
        self.folder = make_folder(folder)
        remove_abandoned(self.folder)

    def path(self, stage: str, key: str) -> Path:
        """Return the path of a stage's result with this content key, whether or not it exists."""
        return self.folder / f"{stage}-{key[:40]}.npz"

    def load(self, stage: str, key: str, kind: type[T]) -> T | None:
        """Load a stored result, or return None if there is no readable one.

        Args:
            stage: the stage's name.
            key: content key of everything that determines the result.
            kind: the dataclass to read.
        """
        try:
            return load_value(self.path(stage, key), kind)
        except (FileFormatError, InvalidInputError):
            return None

    def store(self, stage: str, key: str, value: Any) -> None:
        """Store a dataclass of arrays, numbers and further dataclasses.

        Raises:
            WriteError: if the disk is full or not writable; no partial file is left behind.
        """
        path = self.path(stage, key)
        try:
            save_value(path, value)
        except (OSError, InvalidInputError) as error:
            reason = cannot_write(path, error) if isinstance(error, OSError) else error
            raise WriteError(
                f"{reason} Stages that are already in the cache will be reused."
            ) from error


def cached(
    cache: StageCache | None,
    stage: str,
    kind: type[T],
    compute: Callable[[], T],
    **inputs: Any,
) -> T:
    """Return the result of `compute()`, from the cache if an earlier run stored it.

    Args:
        cache: holds the results of finished stages, or None.
        stage: the stage's name.
        kind: the dataclass that `compute` returns.
        compute: called only if there is no stored result.
        **inputs: everything that determines the result, as for `content_key`.

    Raises:
        InvalidInputError: as `content_key`.
        WriteError: if the result cannot be stored.
    """
    if cache is None:
        return compute()
    key = content_key(stage, **inputs)
    stored = cache.load(stage, key, kind)
    if stored is not None:
        return stored
    value = compute()
    cache.store(stage, key, value)
    return value


def content_key(stage: str, *packages: str, **inputs: Any) -> str:
    """Hash everything that determines a result: equal content, equal key.

    Args:
        stage: the stage's name.
        *packages: sub-packages of catfree whose code makes the result; all of catfree if none.
        **inputs: detections, scenes, settings, objects with a fingerprint, and JSON values.

    Raises:
        InvalidInputError: if a detector, embedder or reconstructor has no fingerprint, so that its
            results cannot be told from those of another.
    """
    told_apart = {name: _told_apart(name, value) for name, value in inputs.items()}
    return hash_parameters(stage, code_hash(*packages), **told_apart)


def _told_apart(name: str, value: Any) -> Any:
    """Represent an input by JSON values that differ whenever the input differs."""
    if value is None or type(value) in (bool, int, float, str, list, tuple):
        return value
    if isinstance(value, Detections | Scene | Settings):
        return content_hash(value)
    fingerprint = getattr(value, "fingerprint", None)
    if not isinstance(fingerprint, str) or not fingerprint:
        raise InvalidInputError(
            f"The {name} {type(value).__name__} has no fingerprint, so its results cannot be "
            "cached. Give it a property `fingerprint` that identifies weights and parameters, or "
            "run without cache_dir."
        )
    return fingerprint


def save_value(path: Path, value: Any) -> Path:
    """Write a dataclass of arrays, numbers and further dataclasses to one archive.

    Raises:
        InvalidInputError: as `save_arrays`.
        WriteError: as `save_arrays`.
    """
    return save_arrays(path, type(value).__name__, to_arrays(value))


def load_value(path: Path, kind: type[T]) -> T:
    """Read what `save_value` wrote.

    Raises:
        InvalidInputError: if there is no such file, or a value in it is not valid.
        FileFormatError: if the file holds something else.
    """
    arrays = load_arrays(path, kind.__name__, required=None)
    with naming_file(path):
        return from_arrays(kind, arrays)


def to_arrays(value: Any) -> Arrays:
    """Map field names of a dataclass to arrays, with `outer.inner` for fields of a nested one."""
    arrays: Arrays = {}
    for field in dataclasses.fields(value):
        item = getattr(value, field.name)
        if dataclasses.is_dataclass(item):
            nested = to_arrays(item)
            arrays |= {f"{field.name}{SEPARATOR}{name}": array for name, array in nested.items()}
        elif item is not None and not (isinstance(item, tuple) and not item):
            arrays[field.name] = np.asarray(item)
    return arrays


def from_arrays(kind: type[T], arrays: Arrays) -> T:
    """Rebuild the dataclass that `to_arrays` converted.

    Raises:
        FileFormatError: if a required field is missing.
        InvalidInputError: if a field does not have its declared type, or violates an invariant of
            its dataclass.
    """
    values: dict[str, Any] = {}
    _, optional = arguments_of(kind)
    for name, hint in typing.get_type_hints(kind).items():
        options = options_of(hint)
        prefix = name + SEPARATOR
        inner = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
        nested = next((o for o in options if dataclasses.is_dataclass(o)), None)
        if isinstance(nested, type) and (inner or types.NoneType not in options):
            values[name] = from_arrays(nested, inner)
        elif name in arrays:
            array = arrays[name]
            scalar = any(o in (bool, int, float, str) for o in options)
            listed = any(typing.get_origin(o) is tuple for o in options)
            if scalar and array.ndim:
                raise FileFormatError(f"A stored {kind.__name__} has several values of {name!r}.")
            values[name] = array.item() if scalar else tuple(array.tolist()) if listed else array
        elif types.NoneType in options:
            values[name] = None
        elif name not in optional:
            raise FileFormatError(f"A stored {kind.__name__} lacks {name!r}.")
    require_declared_types(kind, values)
    value = kind(**values)
    if isinstance(value, Localization):
        require_sound_localization(value)
    return value


def content_hash(value: Any) -> str:
    """Compute the SHA-256 of a dataclass of arrays: equal content, equal hash."""
    digest = hashlib.sha256(type(value).__name__.encode())
    for name, array in sorted(to_arrays(value).items()):
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@functools.cache
def code_hash(*packages: str) -> str:
    """Compute the SHA-256 of the source of these sub-packages of catfree, or of all if none."""
    root = Path(__file__).parents[1]
    folders = [root / package for package in packages] or [root]
    digest = hashlib.sha256()
    for source in sorted(path for folder in folders for path in folder.rglob("*.py")):
        digest.update(str(source.relative_to(root)).encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()
