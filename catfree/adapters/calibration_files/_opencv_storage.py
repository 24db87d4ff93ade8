"""Reader of the XML, YAML and JSON files that OpenCV's `FileStorage` writes.

OpenCV's own parser is not used, because it cannot read the bare text of some published calibrations
and damaged files can crash the process.
"""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from catfree.adapters.calibration_files._named_rig import FileCamera, NamedRig, rig_of
from catfree.adapters.files._camera_names import names_of_files
from catfree.adapters.files._documents import (
    StrPath,
    naming_file,
    numbers,
    read_text,
)
from catfree.errors import FileFormatError, InvalidInputError, quoted
from catfree.types._validation import as_paths, parse_json

_MATRIX = "opencv-matrix"
_YAML_ENTRY = re.compile(r"([A-Za-z_][\w.-]*)\s*:\s*(.*)")
_YAML_DATA = re.compile(r"\bdata:\s*\[")
# What YAML's special numbers, true and false are to `float`.
_YAML_SPECIAL = {
    ".nan": "nan", ".inf": "inf", "+.inf": "inf", "-.inf": "-inf", "true": "1", "false": "0",
}  # fmt: skip


class Storage(NamedTuple):
    """The top-level entries of a file, by name.

    Attributes:
        numbers: (n,) float64 of each matrix, row by row, and of each number or list of numbers.
        words: other entries, as text.
    """

    numbers: dict[str, np.ndarray]
    words: dict[str, str]


def read_storage(path: StrPath, meaning: str) -> Storage:
    """Read the top-level matrices, numbers, lists of numbers and words of a file.

    Args:
        path: the file; the first character distinguishes XML (`<`), JSON (`{`) and YAML.
        meaning: description for messages: `intrinsics of camera C1`.

    Returns:
        Numbers and words; entries of other kinds are skipped.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is malformed (as when truncated), or holds no numbers.
    """
    text = read_text(path, meaning).strip()
    parse = {"<": _xml_entries, "{": _json_entries}.get(text[:1], _yaml_entries)
    storage = Storage({}, {})
    try:
        for name, entry in parse(text):
            if name in storage.numbers or name in storage.words:
                raise ValueError(f"{name} is stated twice")
            if (plain := _plain_numbers(entry)) is not None:
                storage.numbers[name] = plain
            elif isinstance(entry, str):
                storage.words[name] = entry
            elif isinstance(entry, list) and all(isinstance(word, str) for word in entry):
                storage.words[name] = " ".join(entry)
    except (ElementTree.ParseError, ValueError, KeyError, RecursionError) as error:
        raise FileFormatError(
            f"{path} ({meaning}) is malformed ({quoted(error)}). Is the file complete?"
        ) from error
    if not storage.numbers:
        raise FileFormatError(f"{path} ({meaning}) does not hold numbers as OpenCV writes them.")
    return storage


def read_matrices(
    path: StrPath, meaning: str, shapes: dict[str, tuple[int, ...]]
) -> dict[str, np.ndarray]:
    """Read some matrices of a file; see `read_storage`.

    Args:
        path: the file.
        meaning: description for messages.
        shapes: required names and their shapes.

    Raises:
        InvalidInputError: if there is no such file or a number is not finite.
        FileFormatError: if it is malformed or lacks one of the matrices.
    """
    values = read_storage(path, meaning).numbers
    missing = [name for name in shapes if name not in values]
    if missing:
        raise FileFormatError(f"{path} ({meaning}) has no {missing[0]!r}.")
    with naming_file(path):
        return {name: numbers(values[name], shape, f"{name!r}") for name, shape in shapes.items()}


def read_cameras(
    paths: StrPath | Sequence[StrPath], meaning: str, camera_of: Callable[[Storage], FileCamera]
) -> NamedRig:
    """Read one camera per file, named after the file; errors name the file.

    Args:
        paths: one file or several, in the order of the rig's cameras.
        meaning: description for messages.
        camera_of: makes the camera from the entries of a file.

    Raises:
        InvalidInputError: if a file is missing or given twice, or a camera is invalid.
        FileFormatError: if a file is malformed.
    """
    sources = as_paths(paths, "paths")
    if not sources:
        raise InvalidInputError("The list of calibration files is empty. Name one per camera.")
    names, cameras = names_of_files(sources), []
    for source in sources:
        storage = read_storage(source, meaning)
        with naming_file(source):
            cameras.append(camera_of(storage))
    with naming_file(", ".join(source.name for source in sources)):
        return NamedRig(rig_of(cameras), tuple(names))


def _plain_numbers(entry: Any) -> np.ndarray | None:
    """Parse a number, a list of numbers, or words to (n,) numbers; None for anything else."""
    words = entry.split() if isinstance(entry, str) else entry
    try:
        array = np.asarray(words, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        return None
    return array if array.size else None


def _xml_entries(text: str) -> Iterable[tuple[str, Any]]:
    for node in ElementTree.fromstring(text):
        data = node.find("data")
        yield node.tag, (node if data is None else data).text or ""


def _json_entries(text: str) -> Iterable[tuple[str, Any]]:
    for name, value in parse_json(text).items():
        is_matrix = isinstance(value, dict) and value.get("type_id") == _MATRIX
        yield name, value["data"] if is_matrix else value


def _yaml_entries(text: str) -> Iterable[tuple[str, Any]]:
    """Parse the subset of YAML that OpenCV writes: an entry begins where a line is not indented."""
    blocks: list[tuple[str, list[str]]] = []
    for line in text.splitlines():
        if not line.strip() or line.startswith(("%", "---", "...", "#")):
            continue
        if line[0].isspace() or line[0] == "-":
            if not blocks:
                raise ValueError("it begins with an indented line")
            blocks[-1][1].append(line)
        elif match := _YAML_ENTRY.fullmatch(line.rstrip()):
            blocks.append((match[1], [match[2]]))
        else:
            raise ValueError(f"{line[:40]!r} is not an entry")
    for name, lines in blocks:
        body = "\n".join(lines)
        if lines[0].startswith(f"!!{_MATRIX}"):
            data, end = _YAML_DATA.search(body), body.rfind("]")
            if data is None or end < data.end():
                raise ValueError(f"matrix {name} is incomplete")
            yield name, _yaml_words(body[data.end() : end])
        elif lines[0].startswith("["):
            if not body.rstrip().endswith("]"):
                raise ValueError(f"list {name} is incomplete")
            yield name, _yaml_words(body.strip()[1:-1])
        elif lines[0] == "":
            items = (re.sub(r"^\s*-\s", "", line) for line in lines[1:])
            yield name, _yaml_words(" ".join(items))
        else:
            yield name, _yaml_words(lines[0])


def _yaml_words(text: str) -> list[str]:
    words = text.replace(",", " ").split()
    return [_YAML_SPECIAL.get(word.lower(), word) for word in words]
