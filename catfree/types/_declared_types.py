"""Whether values are what the fields of a dataclass declare."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Any

from jaxtyping import AbstractArray, jaxtyped

from catfree.errors import InvalidInputError, quoted


def options_of(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union, or the type itself."""
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)


def require_declared_types(kind: type, values: Mapping[str, Any]) -> None:
    """Raise unless arrays and numbers are what the fields of a dataclass declare.

    An axis name stands for one length in all fields, so columns of unequal length raise, too.

    Args:
        kind: the dataclass.
        values: field name to value.

    Raises:
        InvalidInputError: naming the first field.
    """
    hints = typing.get_type_hints(kind)
    with jaxtyped("context"):
        for field in dataclasses.fields(kind):
            if field.name not in values:
                continue
            item, options = values[field.name], options_of(hints[field.name])
            arrays = tuple(o for o in options if _is_array_type(o))
            if item is None and types.NoneType in options:
                continue
            if arrays and not isinstance(item, arrays):
                given = f"shape {getattr(item, 'shape', '?')}, type {getattr(item, 'dtype', '?')}"
                raise InvalidInputError(
                    f"{field.name} ({given}) does not fit the other columns or the "
                    f"{arrays[0].__name__} that belongs there."
                )
            plain = tuple(o for o in options if o in (bool, int, float, str))
            if plain and not isinstance(item, (*plain, int) if float in plain else plain):
                raise InvalidInputError(f"{field.name} is {quoted(item)}, not {plain[0].__name__}.")


def _is_array_type(option: Any) -> bool:
    return isinstance(option, type) and issubclass(option, AbstractArray)
