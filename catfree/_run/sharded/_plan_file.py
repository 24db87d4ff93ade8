"""A plan as a file, for systems that start one process per shard."""

import dataclasses
import json
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from catfree._run.sharded._from_json import from_json
from catfree._run.sharded._shard import Shard
from catfree.adapters.files._documents import StrPath, document_of, write_text_atomically
from catfree.errors import FileFormatError, InvalidInputError, quoted
from catfree.settings._settings import Method
from catfree.types._validation import as_path

METHODS = ("default", *typing.get_args(Method))
_SCHEMA = "catfree plan 1"


@dataclass(frozen=True)
class PlanFile:
    """Shards and everything needed to run them, as paths.

    Attributes:
        shards: shards of one recording.
        scene: path of the scene.
        out: folder of the results.
        method: "default", "paper" or "evidence".
        detector: path of an ONNX file, empty for none.
        embedder: path of an ONNX file, empty for none.
        unit: length of one unit of a scene whose file does not state it, as `read_scene` takes it.
    """

    shards: tuple[Shard, ...]
    scene: str
    out: str
    method: str = "default"
    detector: str = ""
    embedder: str = ""
    unit: str = "m"


def write_plan(path: StrPath, plan: PlanFile) -> Path:
    """Write a plan as JSON.

    Raises:
        InvalidInputError: if a shard holds its boxes in memory (save them to a file first), or if
            the folder has finished shards of a plan with another scene, method or networks.
        WriteError: if the disk is full or not writable.
    """
    if not all(isinstance(shard.detections, str | None) for shard in plan.shards):
        raise InvalidInputError(
            "A plan in a file needs its boxes in a file. Save them with Detections.save or "
            "cf.adapters.write_detections_parquet, and pass the path to cf.shards."
        )
    _require_same_run(as_path(path, "path"), plan)
    document = {"schema": _SCHEMA} | dataclasses.asdict(plan)
    return write_text_atomically(path, json.dumps(document, indent=1) + "\n")


def _require_same_run(path: Path, plan: PlanFile) -> None:
    """Raise if finished shards next to the path differ from the plan in more than the shards."""
    if not any(path.parent.glob("part-*.json")):
        return
    try:
        earlier = read_plan(path)
    except (FileFormatError, InvalidInputError):  # damaged, of another version, or absent
        return
    for name in ("scene", "unit", "method", "detector", "embedder"):
        if getattr(earlier, name) != getattr(plan, name):
            raise InvalidInputError(
                f"{path.parent} holds finished shards of a plan with another {name}, "
                f"{quoted(getattr(earlier, name))}. Name another folder, or delete this one first."
            )


def read_plan(path: StrPath) -> PlanFile:
    """Read what `write_plan` wrote.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is damaged or of another version.
    """
    with document_of(path, _SCHEMA, "plan", "Make it again with catfree plan.") as document:
        plan = from_json(PlanFile, document, "plan")
        if plan.method not in METHODS:
            raise InvalidInputError(f"method is {quoted(plan.method)}")
        if [shard.index for shard in plan.shards] != list(range(len(plan.shards))):
            raise InvalidInputError("its shards are not in order")
        return plan


def shard_at(plan: Sequence[Shard], index: int) -> Shard:
    """Return the shard of a plan with this index.

    Raises:
        InvalidInputError: if there is no such shard.
    """
    if not 0 <= index < len(plan):
        raise InvalidInputError(
            f"There is no shard {index}: the plan counts them from 0 to {len(plan) - 1}."
        )
    return plan[index]
