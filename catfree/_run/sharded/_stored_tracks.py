"""`open_tracks`: read the joined table of a recording part by part."""

import os
import typing
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from catfree._run.sharded._from_json import from_json
from catfree._run.sharded._receipt import (
    MANIFEST,
    MANIFEST_SCHEMA,
    read_scene_of,
    require_hash,
)
from catfree.adapters.files._documents import StrPath, document_of, require_folder
from catfree.adapters.tables._parquet import open_dataset
from catfree.adapters.tables._tracks_table import read_tracks_parquet
from catfree.errors import FileFormatError, InvalidInputError, quoted, shortened
from catfree.types import Clock, Scene, Tracks
from catfree.types._validation import as_float, as_number, refuse, require_shape


@dataclass(frozen=True)
class StoredPart:
    """One file of a joined table.

    Attributes:
        path: the Parquet file.
        first: first frame that it covers.
        stop: frame after the last one.
        rows: number of positions.
        sha256: hash of the file.
        boxes_used: share of the boxes that support a position, a measure of how well they fit the
            scene.
        warnings: warnings of its shard about the input, and cameras that moved, are late or are
            dead.
    """

    path: Path
    first: int
    stop: int
    rows: int
    sha256: str
    boxes_used: float | None
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class StoredTracks:
    """The tracks of a recording on disk; iterating reads one part after another.

    Attributes:
        folder: the folder of the recording.
        scene: cameras and ground.
        camera_names: (C,) names of the cameras.
        clock: time of the frames.
        people: number of identities.
        parts: the files, in order of time.
    """

    folder: Path
    scene: Scene
    camera_names: tuple[str, ...]
    clock: Clock
    people: int
    parts: tuple[StoredPart, ...]

    def __len__(self) -> int:
        return sum(part.rows for part in self.parts)

    def __iter__(self) -> Iterator[Tracks]:
        """Yield the tracks of one part after another, sorted by frame, then track."""
        return map(self._read, self.parts)

    def between(self, begin: float | int, end: float | int) -> Tracks:
        """Read the positions from `begin` to before `end`, in seconds on the clock.

        Raises:
            InvalidInputError: if one of them is not a number; infinity is.
        """
        for name, value in (("begin", begin), ("end", end)):
            seconds = as_float(value, name)
            require_shape(seconds, (), name)
            refuse(np.isnan(seconds), seconds, name, "; it must be a number of seconds.")
        chosen = [
            part
            for part in self.parts
            if self.clock.seconds(part.stop) > begin and self.clock.seconds(part.first) < end
        ]
        tracks = self._concatenate(map(self._read, chosen))
        time = self.clock.seconds(tracks.frame)
        return tracks[(time >= begin) & (time < end)]

    def read(self) -> Tracks:
        """Read all tracks into memory."""
        return self._concatenate(iter(self))

    def dataset(self) -> Any:
        """Open the table as a `pyarrow.dataset.Dataset`, for queries that read only their rows."""
        return open_dataset([str(part.path) for part in self.parts])

    def _read(self, part: StoredPart) -> Tracks:
        require_hash(part.path, part.sha256, "Join the shards again.")
        return read_tracks_parquet(part.path, self.scene.ground)

    def _concatenate(self, parts: Iterator[Tracks]) -> Tracks:
        full = [replace(part, clock=self.clock) for part in parts if len(part)]
        if not full:
            return self._read(self.parts[0])[:0]
        return jax.tree.map(lambda *columns: np.concatenate(columns), *full)


def open_tracks(out: StrPath) -> StoredTracks:
    """Open a joined recording without reading its positions.

        for tracks in cf.open_tracks("day"):
            ...  # the tracks of ten minutes

    Args:
        out: folder of the recording, completed by `join` or `run_shards`.

    Returns:
        The table on disk; only the part being read is in memory.

    Raises:
        InvalidInputError: if the folder does not exist or its shards are not joined.
        FileFormatError: if the manifest is damaged or of another version, a part is missing, or
            the scene does not match the manifest.
    """
    folder = require_folder(out, "joined shards")
    path = folder / MANIFEST
    if not path.is_file():
        raise InvalidInputError(
            f"{folder} has no {MANIFEST}: its shards have not been joined. Run cf.join first."
        )
    with document_of(path, MANIFEST_SCHEMA, "manifest", "Join the shards again.") as document:
        clock = from_json(Clock, document["clock"], "clock")
        parts = tuple(_part(folder, row) for row in document["parts"])
        if not parts:
            raise InvalidInputError("it lists no parts")
        people, sha256 = int(document["people"]), document["scene_file"]
    scene, names = read_scene_of(folder, sha256)
    for part in parts:
        if not os.path.isfile(part.path):  # also False if the name is too long
            raise FileFormatError(f"{part.path} is missing. Join the shards again.")
    return StoredTracks(folder, scene, names, clock, people, parts)


def row_of(part: StoredPart) -> dict[str, Any]:
    """Return the manifest's entry for a part."""
    rest = {name: value for name, value in vars(part).items() if name != "path"}
    return {"file": part.path.name} | rest


def _part(folder: Path, row: dict[str, Any]) -> StoredPart:
    """Read what `row_of` returned."""
    name = row["file"]
    if not isinstance(name, str) or Path(name).name != name or name != shortened(name):
        raise InvalidInputError(f"{quoted(name)} is not the name of a part")
    hints = typing.get_type_hints(StoredPart)
    del hints["path"]
    values = {name: from_json(hint, row[name], name) for name, hint in hints.items()}
    if values["boxes_used"] is not None:
        as_number(values["boxes_used"], "boxes_used")
    return StoredPart(folder / name, **values)
