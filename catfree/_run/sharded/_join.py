"""`join`: join the tables of shards into one table of the recording."""

import functools
import itertools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

import catfree
from catfree._run._cache import load_value
from catfree._run.sharded._from_json import from_json
from catfree._run.sharded._identities import (
    Identities,
    Pairs,
    ShardSummary,
    identify_recording,
)
from catfree._run.sharded._overlap import match_tracks
from catfree._run.sharded._plan_file import read_plan
from catfree._run.sharded._receipt import (
    MANIFEST,
    MANIFEST_SCHEMA,
    PLAN,
    WORK_FOLDER,
    Receipt,
    files_of,
    read_receipt,
    read_scene_of,
    remove_beyond,
    require_intact,
)
from catfree._run.sharded._run_shard import PLACES
from catfree._run.sharded._shard import Shard
from catfree._run.sharded._stored_tracks import StoredPart, StoredTracks, open_tracks, row_of
from catfree.adapters.files._documents import (
    StrPath,
    require_folder,
    write_text_atomically,
)
from catfree.adapters.files._fingerprint import hash_file
from catfree.adapters.tables._parquet import open_dataset, read_parquet, write_parquet
from catfree.errors import FileFormatError, InvalidInputError
from catfree.methods.evidence.report._working_area import usual_place
from catfree.settings import Settings
from catfree.types import Tracks

if TYPE_CHECKING:
    import pyarrow

# Maps the columns `PLACES` to whether each position is in the working area.
Area = Callable[[Float[np.ndarray, "m 2"]], Bool[np.ndarray, " m"]]

INSTANTS = 20_000  # maximum used to learn the working area: an hour at five per second


def join(out: StrPath) -> Tracks:
    """Join the finished shards of a recording into one table and read it.

    Args:
        out: folder of the recording, to which the shards were written.

    Returns:
        The tracks of the whole recording, without `support`, which the table lacks. For
        recordings that do not fit into memory, use `run_shards` and `open_tracks`.

    Raises:
        InvalidInputError: if there is no finished shard.
        FileFormatError: naming the shard that is missing, damaged, of another version, or made with
            different settings, code, scene or plan.
        WriteError: if the disk is full or not writable.
    """
    return join_shards(out).read()


def join_shards(out: StrPath, plan: Sequence[Shard] | None = None) -> StoredTracks:
    """Join as `join` does, with at most one shard in memory.

    Each person gets one identity: tracks of neighboring shards are matched where the shards
    overlap, then fragments are joined across gaps by appearance and motion, over all shards.

    Args:
        out: as `join`.
        plan: shards of the recording, some of which may have run elsewhere; None for the plan in
            the folder, if there is one.

    Returns:
        The joined table.

    Raises:
        CatFreeError: as `join`.
    """
    folder = require_folder(out, "results of shards")
    stored = folder / PLAN
    if plan:
        _leave_earlier_plan(folder, plan)
    elif stored.is_file():
        advice = f" If they ran by another plan, delete {stored}."
        _leave_earlier_plan(folder, read_plan(stored).shards, advice)
    receipts = read_receipts(folder)
    first = receipts[0]
    _, camera_names = read_scene_of(folder, first.scene_file)
    (folder / MANIFEST).unlink(missing_ok=True)  # its presence means that the table is complete
    summaries = [load_value(files_of(folder, r.index).fragments, ShardSummary) for r in receipts]
    matched = [_match(folder, one, two) for one, two in itertools.pairwise(receipts)]
    identities = identify_recording(summaries, matched)
    area = _learn_area(folder, receipts)
    last = max(int(part.identity.max(initial=-1)) for part in identities)
    numbers = np.full(last + 1, -1)
    parts = [
        _write_joined(folder, receipt, part, area, numbers, camera_names)
        for receipt, part in zip(receipts, identities, strict=True)
    ]
    for stale in folder.glob("part-*.parquet"):
        if stale.name not in {part.path.name for part in parts}:
            stale.unlink()
    document = {
        "schema": MANIFEST_SCHEMA,
        "catfree": catfree.__version__,
        "done": True,
        "source": first.source,
        "run": first.run,
        "settings": first.settings,
        "scene_file": first.scene_file,
        "clock": first.clock,
        "people": int(numbers.max(initial=-1)) + 1,
        "parts": list(map(row_of, parts)),
    }
    write_text_atomically(folder / MANIFEST, json.dumps(document, indent=1) + "\n")
    return open_tracks(folder)


def _leave_earlier_plan(folder: Path, plan: Sequence[Shard], advice: str = "") -> None:
    """Remove the shards of an earlier plan once all shards of this plan are finished.

    Raises:
        FileFormatError: if some are not finished, or a receipt is damaged.
    """
    receipts = [files_of(folder, shard.index).receipt for shard in plan]
    finished = {read_receipt(path).shard for path in receipts if path.is_file()}
    unfinished = [shard.index for shard in plan if shard.fingerprint not in finished]
    _require_finished(folder, unfinished, plan[0].count, advice)
    remove_beyond(folder, plan[0].count)


def _require_finished(
    folder: Path, unfinished: Sequence[int], count: int, advice: str = ""
) -> None:
    if unfinished:
        listed = ", ".join(map(str, unfinished[:5])) + (", ..." if len(unfinished) > 5 else "")
        raise FileFormatError(
            f"{folder}: {len(unfinished)} of {count} shards of the plan are not finished "
            f"({listed}). Run them with cf.run_shard.{advice}"
        )


def read_receipts(folder: Path) -> list[Receipt]:
    """Read the receipts of all shards of a recording, and check that they belong together.

    Args:
        folder: folder of the recording.

    Raises:
        InvalidInputError: if there is no receipt.
        FileFormatError: naming the shard that is missing, damaged, or inconsistent with the rest.
    """
    paths = sorted((folder / WORK_FOLDER).glob("part-*.json"))
    if not paths:
        raise InvalidInputError(f"{folder} holds no finished shard. Run cf.run_shard first.")
    receipts = sorted(map(read_receipt, paths), key=lambda receipt: receipt.index)
    first = receipts[0]
    for receipt in receipts:
        for name, difference in (
            ("source", "another recording"),
            ("count", "another plan"),
            ("scene_file", "another scene"),
            ("run", "other settings, other networks or another version of catfree"),
        ):
            if getattr(receipt, name) != getattr(first, name):
                raise FileFormatError(
                    f"{files_of(folder, receipt.index).receipt}: shard {receipt.index} was made "
                    f"with {difference} than shard {first.index}. Run all shards of one plan with "
                    "the same scene and settings, and delete this file if the plan has no such "
                    "shard."
                )
    missing = set(range(first.count)) - {receipt.index for receipt in receipts}
    _require_finished(folder, sorted(missing), first.count)
    for one, two in itertools.pairwise(receipts):
        if one.stop != two.first:
            raise FileFormatError(
                f"{folder}: shard {one.index} ends before frame {one.stop}, but shard {two.index} "
                f"begins at frame {two.first}. Run all shards of one plan."
            )
    for receipt in receipts:
        require_intact(files_of(folder, receipt.index), receipt)
    return receipts


def _match(folder: Path, earlier: Receipt, later: Receipt) -> Pairs:
    """Match two neighboring shards in the frames of both."""
    one, two = (
        Tracks.from_arrow(_rows(folder, receipt, later.first_seen, earlier.stop_seen))
        for receipt in (earlier, later)
    )
    return match_tracks(one, two)


def _rows(
    folder: Path, receipt: Receipt, first: int, stop: int, names: list[str] | None = None
) -> "pyarrow.Table":
    """Read a shard's table, or some columns, for the frames from `first` to before `stop`."""
    opened = open_dataset([str(files_of(folder, receipt.index).part)])
    import pyarrow.dataset

    field = pyarrow.dataset.field("frame")
    return opened.to_table(columns=names, filter=(field >= first) & (field < stop))


def _learn_area(folder: Path, receipts: list[Receipt]) -> Area | None:
    """Learn the working area from the positions at instants spread over the recording.

    Returns:
        None if the working area is switched off, or the method has none.
    """
    settings = from_json(Settings, receipts[0].settings, "settings").evidence
    heights = [receipt.person_height for receipt in receipts if receipt.person_height is not None]
    if not settings.working_area or not heights:
        return None
    every = -(-(receipts[-1].stop - receipts[0].first) // INSTANTS)
    kinds, places, last = ["x", "y", *PLACES], [], -1
    for receipt in receipts:
        table = _rows(folder, receipt, receipt.first, receipt.stop, ["frame", *kinds])
        column = {name: table[name].to_numpy() for name in table.column_names}
        # The first frame with people in each stretch of `every` frames.
        present = np.unique(column["frame"])
        stretch, first = np.unique(present // every, return_index=True)
        chosen = np.isin(column["frame"], present[first[stretch > last]])
        chosen &= ~np.isnan(column["design_sigma"])
        places.append(np.stack([column[name][chosen] for name in kinds], axis=-1))
        last = int(stretch.max(initial=last))
    place, height = np.concatenate(places), float(np.median(heights))
    if len(place) == 0:
        return None
    cameras = {camera for receipt in receipts for camera in receipt.cameras}
    usual = usual_place(place[:, :2] / height, place[:, 2:], settings)
    return functools.partial(usual.holds, cameras=len(cameras), settings=settings)


def _write_joined(
    folder: Path,
    receipt: Receipt,
    identities: Identities,
    area: Area | None,
    numbers: np.ndarray,
    camera_names: Sequence[str],
) -> StoredPart:
    """Write the positions that a shard reports, with their identities in the recording.

    Args:
        folder: folder of the recording.
        receipt: receipt of the shard, whose predecessors have been written.
        identities: identities of its tracks.
        area: positions outside are not reported; None for all positions.
        numbers: (K,) number of each identity in the table, -1 before its first appearance; numbers
            of identities that first appear in this shard are entered.
        camera_names: (C,) names for the metadata.
    """
    files = files_of(folder, receipt.index)
    table = read_parquet(files.part, "positions of a shard")
    frame, local = (table[name].to_numpy() for name in ("frame", "track_id"))
    reported = (frame >= receipt.first) & (frame < receipt.stop)
    if area is not None:
        coverage = np.column_stack([table[name].to_numpy() for name in PLACES])
        reported &= np.isnan(coverage[:, 0]) | area(coverage)
    tracked = np.flatnonzero(reported & (local >= 0))
    identity = np.full(len(local), -1)
    identity[tracked], stop = identities.of(local[tracked])
    reported[tracked] = frame[tracked] < stop
    rows = np.flatnonzero(reported)
    frame, identity = frame[rows], identity[rows]
    appear = np.lexsort((identity, frame))
    names, first = np.unique(identity[appear], return_index=True)
    new = names[np.argsort(first)]
    new = new[new >= 0]
    new = new[numbers[new] < 0]
    numbers[new] = numbers.max(initial=-1) + 1 + np.arange(len(new))
    number = np.where(identity >= 0, numbers[identity], -1) if len(numbers) else identity
    order = np.lexsort((number, frame))
    table = table.drop_columns(PLACES).take(rows[order])
    at = table.schema.get_field_index("track_id")
    table = table.set_column(at, table.schema.field(at), [number[order]])
    metadata = {**table.schema.metadata, b"camera_names": json.dumps(camera_names)}
    table = table.replace_schema_metadata(metadata)
    path = write_parquet(folder / files.part.name, table, compression="zstd")
    return StoredPart(
        path=path,
        first=receipt.first,
        stop=receipt.stop,
        rows=len(table),
        sha256=hash_file(path),
        boxes_used=receipt.boxes_used,
        warnings=receipt.warnings,
    )
