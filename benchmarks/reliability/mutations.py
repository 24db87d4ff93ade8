"""Seeded damage to the bytes, words and arrays of a file."""

import datetime
import decimal
import io
import re
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet

Generator = np.random.Generator
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][\w-]*")
# Values that no field of any format can have: more digits than Python converts, beyond float64, not
# a number, beyond 63 bits, and empty.
_IMPOSSIBLE = (
    *(b"9" * 5000, b"-" + b"9" * 5000, b"0." + b"9" * 5000, b"1" + b"0" * 5000 + b".5"),
    *(b"1e999", b"-1e999", b"nan", b"NaN", b"", b'""'),
    *(b"9223372036854775808", b"-9223372036854775809", b"18446744073709551616"),
)
_TOKENS = (
    *(b"NaN", b"nan", b".nan", b"Infinity", b"-Infinity", b"inf", b"-inf", b"1e308", b"-1e308"),
    *(
        b"1e400",
        b"1e-320",
        b"9223372036854775808",
        b"-9223372036854775809",
        b"18446744073709551616",
    ),
    *(b"0", b"-1", b"-0", b"0.5", b"9" * 5000, b"", b"null", b"true", b'"x"', b"[]", b"{}", b"1 2"),
    *(b"0x10", b"1_000", b"\xff\xfe", b"1970-01-01", b"[" * 3000, b'{"a":' * 3000, b"a." * 3000),
)
# Values of a table's column in place of a number or a text.
_VALUES: tuple[Any, ...] = (
    *(None, np.nan, np.inf, -np.inf, -1, 0, 2**40, 2**62, -(2**63), 2**64 - 1, 1e308, -1e308, 0.5),
    *("", "x" * 5000, "9" * 5000, "nan", "\0", "north ", b"\xff", True, {}, {"a": 1}, {"a": None}),
    *([], [1.0], [None], [[1.0]], [np.nan] * 4, [0.0] * 51),
    *(datetime.date(1970, 1, 1), datetime.datetime(1970, 1, 1), datetime.timedelta(9)),
    *(datetime.time(1), decimal.Decimal("1e30"), decimal.Decimal("0.1")),
)
_TYPES = (
    *(pyarrow.null(), pyarrow.int8(), pyarrow.uint64(), pyarrow.float16(), pyarrow.float32()),
    *(pyarrow.bool_(), pyarrow.string(), pyarrow.large_string(), pyarrow.binary(3)),
    *(pyarrow.timestamp("ns"), pyarrow.decimal128(30, 2), pyarrow.list_(pyarrow.float64())),
    *(pyarrow.list_(pyarrow.float64(), 51), pyarrow.struct([("a", pyarrow.int8())])),
    *(pyarrow.map_(pyarrow.string(), pyarrow.int8()), pyarrow.dictionary("int8", "string")),
)
_STRINGS = (b"", b"x" * 5000, b"\\ud800", b"../../x", b"$a_b_c$", b"\x00", b"<b>", b'"', b"'")


def damaged(content: bytes, rng: Generator) -> bytes:
    """Damage the content; the result nearly always differs."""
    is_archive = content[:2] == b"PK"
    ways: list[Callable[[bytes, Generator], bytes]] = list(_BYTES)
    if content[:4] == b"PAR1":
        ways += _PARQUET * 8
    else:
        ways += _ARCHIVE * 2 if is_archive else _TEXT * 2 if is_text(content) else _BINARY * 2
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        content = ways[rng.integers(len(ways))](content, rng)
    return content


def is_text(content: bytes) -> bool:
    """Return whether a file is text: not an archive, Parquet or another binary format."""
    return content[:2] != b"PK" and content[:4] != b"PAR1" and b"\0" not in content


def flipped(content: bytes, rng: Generator) -> bytes:
    """Flip some bits."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 9)) if data else 0):
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    return bytes(data)


def truncated(content: bytes, rng: Generator) -> bytes:
    """Keep only the beginning."""
    return content[: rng.integers(len(content) + 1)]


def appended(content: bytes, rng: Generator) -> bytes:
    """Append bytes."""
    return content + rng.bytes(int(rng.integers(1, 200)))


def zeroed(content: bytes, rng: Generator) -> bytes:
    """Zero a block, as a disk does after a power failure."""
    a, b = _span(content, rng)
    return content[:a] + bytes(b - a) + content[b:]


def cut(content: bytes, rng: Generator) -> bytes:
    """Remove a block."""
    a, b = _span(content, rng)
    return content[:a] + content[b:]


def doubled(content: bytes, rng: Generator) -> bytes:
    """Duplicate a block."""
    a, b = _span(content, rng)
    return content[:b] + content[a:]


def swapped(content: bytes, rng: Generator) -> bytes:
    """Swap two neighboring blocks."""
    a, b = _span(content, rng)
    c = min(2 * b - a, len(content))
    return content[:a] + content[b:c] + content[a:b] + content[c:]


def other_number(content: bytes, rng: Generator) -> bytes:
    """Replace a number by an odd one."""
    return _replace(NUMBER, content, rng, _TOKENS)


def impossible_number(content: bytes, rng: Generator) -> bytes:
    """Replace a number by one of 5000 digits, one beyond 63 bits or float64, or by none."""
    return _replace(NUMBER, content, rng, _IMPOSSIBLE)


def other_word(content: bytes, rng: Generator) -> bytes:
    """Replace a word by an odd one, or by another word of the file."""
    return _replace(_WORD, content, rng, _STRINGS + tuple(_WORD.findall(content)[:50]))


def other_line(content: bytes, rng: Generator) -> bytes:
    """Remove, duplicate or move a line."""
    lines = content.splitlines(keepends=True)
    if len(lines) < 2:
        return cut(content, rng)
    a, b = (int(at) for at in rng.integers(len(lines), size=2))
    way = rng.integers(3)
    if way == 0:
        del lines[a]
    elif way == 1:
        lines.insert(b, lines[a])
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"".join(lines)


def other_field(content: bytes, rng: Generator) -> bytes:
    """Replace eight bytes by a huge count, NaN or infinity."""
    if len(content) < 8:
        return content
    at = int(rng.integers(len(content) - 7))
    values = (2**63 - 1, 2**64 - 1, 2**32, 0)
    packed = [struct.pack("<Q", value) for value in values]
    packed += [struct.pack("<d", value) for value in (np.nan, np.inf, 1e308, -1e308)]
    return content[:at] + packed[rng.integers(len(packed))] + content[at + 8 :]


def other_array(content: bytes, rng: Generator) -> bytes:
    """Damage one array of an archive, with correct checksums."""
    members = _members(content)
    if not members:
        return content
    name = list(members)[rng.integers(len(members))]
    try:
        array = np.load(io.BytesIO(members[name]), allow_pickle=False)
    except Exception:
        return content
    flat = array.ravel()
    way = int(rng.integers(9))
    with np.errstate(all="ignore"):
        if way == 0 and array.dtype.kind == "f" and array.size:
            flat[rng.integers(flat.size)] = rng.choice([np.nan, np.inf, -np.inf, -1.0, 1e308])
            array = flat.reshape(array.shape)
        elif way == 1:
            array = array.astype("S12" if array.dtype.kind in "US" else complex)
        elif way == 2:
            array = np.full(array.shape, np.datetime64("1970-01-01"))
        elif way == 3:
            array = array.astype(str)
        elif way == 4:
            array = flat[: flat.size // 2]
        elif way == 5:
            array = np.concatenate([flat, flat])
        elif way == 6:
            array = array[None]
        elif way == 7 and array.dtype.kind in "iu" and array.size:
            array = array.astype(np.int64).ravel()
            array[rng.integers(array.size)] = rng.choice([2**62, -(2**62), -1, 2**40])
            array = array.reshape(np.shape(np.load(io.BytesIO(members[name]))))
        else:
            array = np.zeros(array.shape, [("a", "f8")])
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    members[name] = stream.getvalue()
    return _archive(members)


def other_header(content: bytes, rng: Generator) -> bytes:
    """Damage one array header of an archive, with correct checksums."""
    members = _members(content)
    if not members:
        return content
    name = list(members)[rng.integers(len(members))]
    length = 10 + struct.unpack_from("<H", members[name] + bytes(10), 8)[0]
    header, rest = members[name][:length], members[name][length:]
    way = rng.integers(3)
    if way == 0:
        header = flipped(header, rng)
    else:
        header = other_number(header, rng) if way == 1 else other_word(header, rng)
        text = header[10:].rstrip(b" \n")[:60000]
        header = header[:8] + struct.pack("<H", len(text) + 1) + text + b"\n"
    members[name] = header + rest
    return _archive(members)


def other_members(content: bytes, rng: Generator) -> bytes:
    """Remove, rename or duplicate one member of an archive."""
    members = _members(content)
    if not members:
        return content
    name = list(members)[rng.integers(len(members))]
    way = rng.integers(3)
    taken = members.pop(name)
    if way == 1:
        members["x" * int(rng.integers(1, 3000)) + ".npy"] = taken
    elif way == 2:
        members |= {name: taken, name.removesuffix(".npy"): taken}
    return _archive(members)


def other_column(content: bytes, rng: Generator) -> bytes:
    """Damage one column of a Parquet file, with correct checksums."""
    try:
        table = pyarrow.parquet.read_table(io.BytesIO(content))
    except Exception:  # it was damaged before
        return content
    at = int(rng.integers(table.num_columns))
    name, values = table.column_names[at], table.column(at).to_pylist()
    ways = (*range(len(_VALUES)), *range(len(_VALUES)), *range(-8, 0))
    way = int(ways[rng.integers(len(ways))])
    if way == -1:
        table = table.remove_column(at)
    elif way == -2:
        table = table.rename_columns([n.upper() if n == name else n for n in table.column_names])
    elif way == -3:
        table = table.append_column(name, table.column(at))
    elif way == -4:
        table = table.replace_schema_metadata(_other_metadata(table.schema.metadata, rng))
    elif way == -5:
        table = table.slice(0, 0)
    elif way == -6:
        table = table.take(rng.permutation(len(table)))
    elif way == -7:
        table = table.set_column(at, name, pyarrow.array(map(str, values), pyarrow.string()))
    elif way == -8:
        kind = _TYPES[rng.integers(len(_TYPES))]
        table = table.set_column(at, name, pyarrow.nulls(len(table), kind))
    else:
        changed, kind = list(values), table.column(at).type
        if changed:
            changed[rng.integers(len(changed))] = _VALUES[way]
        column = _array(changed, kind) or _array(changed, None)
        column = column or _array([_VALUES[way]] * len(values), None)
        table = table if column is None else table.set_column(at, name, column)
    stream = io.BytesIO()
    try:
        pyarrow.parquet.write_table(table, stream, write_page_checksum=True)
    except Exception:  # a type that the format lacks
        return content
    return stream.getvalue()


def _array(values: list[Any], kind: Any) -> Any:
    """Make a column of values; return None if they have different types."""
    try:
        return pyarrow.array(values, kind)
    except (pyarrow.ArrowException, OverflowError, TypeError, ValueError):
        return None


def _other_metadata(metadata: dict[bytes, bytes] | None, rng: Generator) -> dict[bytes, bytes]:
    """Damage one entry of a table's metadata."""
    changed = dict(metadata or {b"clock": b"null"})
    key = list(changed)[rng.integers(len(changed))]
    ways = (other_number, other_word, impossible_number, cut, truncated)
    changed[key] = ways[rng.integers(len(ways))](changed[key], rng)
    return changed


def _members(content: bytes) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # it was damaged before
        return {}


def _archive(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def _span(content: bytes, rng: Generator) -> tuple[int, int]:
    a = int(rng.integers(len(content) + 1))
    return a, min(a + int(rng.integers(1, 65)), len(content))


def _replace(
    pattern: re.Pattern[bytes], content: bytes, rng: Generator, tokens: tuple[bytes, ...]
) -> bytes:
    found = list(pattern.finditer(content))
    if not found:
        return content
    match = found[rng.integers(len(found))]
    return content[: match.start()] + tokens[rng.integers(len(tokens))] + content[match.end() :]


_BYTES = [flipped, truncated, appended, zeroed, cut, doubled, swapped]
_TEXT = [other_number, other_number, impossible_number, impossible_number, other_word, other_line]
_PARQUET = [other_column]
_BINARY = [other_field, other_field]
_ARCHIVE = [other_array, other_array, other_array, other_header, other_members]
