"""Values of declared types from the JSON of plans and receipts."""

import typing
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

from catfree.errors import InvalidInputError, quoted
from catfree.types._validation import options_of


def from_json(hint: Any, value: Any, name: str) -> Any:
    """Convert a value from `dataclasses.asdict` and JSON back to its declared type.

    Args:
        hint: the type: a dataclass, a tuple, a dictionary, a number or text, or a union of them.
        value: value from the document; dataclass fields with a default may be missing.
        name: name of the value for messages.

    Raises:
        KeyError: if a field without a default is missing.
        ValueError: if a value does not have its type or its dataclass rejects it.
    """
    for option in options_of(hint):
        kind, parts = typing.get_origin(option), typing.get_args(option)
        if type(value) in (option, kind) or (kind is typing.Literal and value in parts):
            return value
        if type(value) is int and option is float:
            return float(value)
        if isinstance(value, list) and kind is tuple:
            kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
            return tuple(from_json(*one, name) for one in zip(kinds, value, strict=True))
        if isinstance(value, dict) and isinstance(option, type) and is_dataclass(option):
            return _record(option, value)
    raise InvalidInputError(f"{name} is {quoted(value)}")


def _record(kind: type, document: dict[str, Any]) -> Any:
    hints, values = typing.get_type_hints(kind), {}
    for field in fields(kind):
        name, required = field.name, field.default is field.default_factory is MISSING
        if required or name in document:
            values[name] = from_json(hints[name], document[name], name)
    return kind(**values)
