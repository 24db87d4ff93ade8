"""Receipts of finished shards, with fingerprints of input, settings, scene and code."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from catfree._run.sharded._from_json import from_json
from catfree._run.sharded._shard import Shard
from catfree.adapters.calibration_files._rig_json import read_scene_json
from catfree.adapters.files._documents import StrPath, document_of, write_text_atomically
from catfree.adapters.files._fingerprint import hash_file
from catfree.errors import FileFormatError, InvalidInputError
from catfree.settings import Settings
from catfree.types import Clock, Scene
from catfree.types._validation import as_number, as_path

SCHEMA = "catfree shards 3"  # for receipts and the tables beside them
MANIFEST_SCHEMA = "catfree shards 1"  # for joined tables
WORK_FOLDER = "_shards"  # readers of Parquet folders skip names that begin with an underscore
SCENE_FILE, MANIFEST = f"{WORK_FOLDER}/scene.json", f"{WORK_FOLDER}/manifest.json"
PLAN = f"{WORK_FOLDER}/plan.json"  # written by `catfree plan`


@dataclass(frozen=True)
class Receipt:
    """Record of a finished shard.

    Attributes:
        schema: version of this format.
        index: index of the shard.
        count: number of shards of its recording.
        first: first frame whose positions the shard reports.
        stop: frame after the last reported one.
        first_seen: first frame that the shard uses.
        stop_seen: frame after the last used one.
        shard: fingerprint of the shard.
        source: fingerprint of the recording.
        run: fingerprint of settings, scene, detector, embedder and code, the same for all shards
            of a recording.
        settings: settings of the localization.
        clock: time of the frames, as the arguments of `Clock`.
        scene_file: SHA-256 of the scene's file beside the receipt.
        part: SHA-256 of the table of positions.
        fragments: SHA-256 of the summary of its tracks.
        boxes: number of boxes used.
        cameras: cameras with boxes.
        boxes_used: share of the boxes that support a position, a measure of how well they fit the
            scene. Like the next two, it includes people outside the working area.
        expected_moda: expected MODA in percent, without labels, or None.
        median_sigma: median uncertainty of the positions in scene units, or None without positions.
        person_height: usual height of a standing person in scene units, or None if unknown.
        seconds: computing time.
        warnings: sentences about the input, and about cameras that moved, are late or are dead.
        verdicts: verdicts of `check` on each camera; empty if there are too few boxes.
    """

    schema: str
    index: int
    count: int
    first: int
    stop: int
    first_seen: int
    stop_seen: int
    shard: str
    source: str
    run: str
    settings: dict[str, Any]
    clock: dict[str, Any]
    scene_file: str
    part: str
    fragments: str
    boxes: int
    cameras: tuple[int, ...]
    boxes_used: float | None
    expected_moda: float | None
    median_sigma: float | None
    person_height: float | None
    seconds: float
    warnings: tuple[str, ...] = ()
    verdicts: tuple[str, ...] = ()


@dataclass(frozen=True)
class ShardFiles:
    """The files of one shard.

    Attributes:
        part: table of positions, including those in the overlaps.
        fragments: summary of its tracks.
        receipt: written last.
    """

    part: Path
    fragments: Path
    receipt: Path


def recording_folder(out: StrPath, site: str, date: str) -> Path:
    """Return the folder of one recording: `out`, or `out/site=.../date=...` as named by Hive."""
    folder = as_path(out, "out")
    for key, value in (("site", site), ("date", date)):
        folder = folder / f"{key}={value}" if value else folder
    return folder


def files_of(folder: Path, index: int) -> ShardFiles:
    """Return the files of a shard in the folder of its recording."""
    work, name = folder / WORK_FOLDER, f"part-{index:05d}"
    return ShardFiles(*(work / f"{name}.{suffix}" for suffix in ("parquet", "npz", "json")))


def remove_beyond(folder: Path, count: int) -> None:
    """Remove shards of a longer earlier plan: those with an index of at least `count`."""
    kept = {path for index in range(count) for path in vars(files_of(folder, index)).values()}
    for path in (folder / WORK_FOLDER).glob("part-*"):
        if path not in kept:
            path.unlink()


def finished_receipt(files: ShardFiles, shard: Shard, run: str) -> Receipt | None:
    """Return the receipt of a shard if it matches and describes the shard's files."""
    try:
        receipt = read_receipt(files.receipt)
        if receipt.shard == shard.fingerprint and receipt.run == run:
            require_intact(files, receipt)
            return receipt
    except (FileFormatError, InvalidInputError):  # another version, damaged, or absent
        pass
    return None


def require_intact(files: ShardFiles, receipt: Receipt) -> None:
    """Raise unless the files of a shard match its receipt.

    Raises:
        FileFormatError: naming the file.
    """
    for path, expected in ((files.part, receipt.part), (files.fragments, receipt.fragments)):
        require_hash(path, expected, f"Run shard {receipt.index} again.")


def require_hash(path: Path, sha256: str, advice: str) -> None:
    """Raise unless a file exists as it was written.

    Raises:
        FileFormatError: naming the file and ending with the advice.
    """
    if not path.is_file():
        raise FileFormatError(f"{path} is missing. {advice}")
    if hash_file(path) != sha256:
        raise FileFormatError(f"{path} was changed or truncated. {advice}")


def read_scene_of(folder: Path, sha256: Any) -> tuple[Scene, tuple[str, ...]]:
    """Read the scene that the shards of a recording were made with, and its camera names.

    Args:
        folder: folder of the recording.
        sha256: hash of the file.

    Raises:
        FileFormatError: if the file is missing, or has another hash or format.
    """
    path = folder / SCENE_FILE
    if not path.is_file() or hash_file(path) != sha256:
        raise FileFormatError(
            f"{path} is not the scene that the shards were made with. Run them again."
        )
    return read_scene_json(path)


def write_receipt(path: Path, receipt: Receipt) -> None:
    """Write a receipt."""
    write_text_atomically(path, json.dumps(dataclasses.asdict(receipt), indent=1) + "\n")


def read_receipt(path: Path) -> Receipt:
    """Read a receipt.

    Raises:
        InvalidInputError: if there is none.
        FileFormatError: if it is damaged or of another version.
    """
    with document_of(path, SCHEMA, "receipt", "Run this shard again.") as document:
        receipt = from_json(Receipt, document, "receipt")
        if not receipt.settings:
            raise InvalidInputError("it has no settings")
        from_json(Clock, receipt.clock, "clock")
        from_json(Settings, receipt.settings, "settings")
        for name, value in vars(receipt).items():
            if isinstance(value, float):
                as_number(value, name)
        return receipt
