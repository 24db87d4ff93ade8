"""Content hashes for cache keys, so that other weights or parameters never match."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from catfree.errors import InvalidInputError
from catfree.types._sampling import evenly_spread
from catfree.types._validation import as_path

_CHUNK = 1 << 20
_SAMPLES = 16


def hash_file(path: str | os.PathLike[str]) -> str:
    """Compute the SHA-256 of a file's bytes in hexadecimal, read in pieces."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def hash_samples(path: str | os.PathLike[str]) -> str:
    """Compute the SHA-256 of a file's size and of evenly spread parts, 16 MiB at most.

    For recordings too large to be read as a whole. Of a folder, the names, the sizes and 16 evenly
    spread files are hashed.

    Raises:
        InvalidInputError: if there is nothing at that path, or it cannot be read.
    """
    source = as_path(path, "path")
    try:
        if source.is_dir():
            files = sorted(file for file in source.rglob("*") if file.is_file())
            names = [
                f"{file.relative_to(source).as_posix()} {file.stat().st_size}" for file in files
            ]
            chosen = evenly_spread(np.array(files), _SAMPLES)
            return hash_parameters("folder", *names, *map(hash_samples, chosen))
        size = source.stat().st_size
        digest = hashlib.sha256(str(size).encode())
        with source.open("rb") as stream:
            for part in range(_SAMPLES):
                stream.seek(part * max(0, size - _CHUNK) // (_SAMPLES - 1))
                digest.update(stream.read(_CHUNK))
                if size <= _CHUNK:
                    break
    except OSError as error:
        raise InvalidInputError(f"Cannot read {source}: {error.strerror or error}.") from error
    return digest.hexdigest()


def hash_parameters(kind: str, *contents: str, **parameters: Any) -> str:
    """Compute the SHA-256 of a name, of other hashes and of parameters that JSON can hold."""
    text = json.dumps([kind, list(contents), parameters], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
