"""Content hashes for cache keys, so that other weights or parameters never match."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

_CHUNK = 1 << 20


def hash_file(path: str | os.PathLike[str]) -> str:
    """Compute the SHA-256 of a file's bytes in hexadecimal, read in pieces."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as stream:
        while piece := stream.read(_CHUNK):
            digest.update(piece)
    return digest.hexdigest()


def hash_parameters(kind: str, *contents: str, **parameters: Any) -> str:
    """Compute the SHA-256 of a name, of other hashes and of parameters that JSON can hold."""
    text = json.dumps([kind, list(contents), parameters], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
