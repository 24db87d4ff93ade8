"""What every class of settings has: constants with their reasons, and refusals of wrong values."""

from dataclasses import field, fields
from functools import lru_cache
from numbers import Integral, Real
from types import UnionType
from typing import Any, ClassVar, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from catfree.errors import InvalidInputError, quoted

T = TypeVar("T")


def constant(
    value: T, kind: Literal["physical", "start", "decision", "numerical"], reason: str
) -> T:
    """A field with its kind, which `docs/evidence_constants.md` explains, and the reason for it."""
    return field(default=value, metadata={"kind": kind, "reason": reason})


class CheckedSettings:
    """Base of the settings, which checks all fields when they are set.

    Attributes:
        not_zero: names of the numbers that divide, or without which nothing is computed.
        shares: names of the probabilities, quantiles and scores, which are at most 1.
    """

    not_zero: ClassVar[frozenset[str]] = frozenset()
    shares: ClassVar[frozenset[str]] = frozenset()

    def __post_init__(self) -> None:
        """Refuse values that a field cannot have.

        Raises:
            InvalidInputError: naming the field, if a value is of another kind than the default,
                NaN, or negative where the default is not; if it is 0 in `not_zero` or above 1 in
                `shares`; or if a range ends before it begins.
        """
        kinds = _kinds(type(self))
        for one in fields(self):  # pyright: ignore[reportArgumentType]
            value, kind = getattr(self, one.name), kinds[one.name]
            expected = _expected(value, kind, one.default, one.name in self.not_zero)
            if not expected and one.name in self.shares and value is not None and np.max(value) > 1:
                expected = "at most 1"
            if expected:
                raise InvalidInputError(
                    f"{type(self).__name__}.{one.name} is {quoted(value)}; it must be {expected}."
                )


@lru_cache
def _kinds(settings: type) -> dict[str, Any]:
    return get_type_hints(settings)


def _expected(value: Any, kind: Any, default: Any, not_zero: bool) -> str:
    """Say what a field takes; empty if that includes the value."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Literal:
        fits = isinstance(value, str) and value in parts
        return "" if fits else f"one of {', '.join(map(repr, parts))}"
    if origin is UnionType:
        expected = "" if value is None else _expected(value, parts[0], 0.0, not_zero)
        return expected and f"None or {expected}"
    if origin is tuple:
        return _expected_numbers(value, parts, default, not_zero)
    if kind is bool:
        return "" if isinstance(value, bool | np.bool_) else "True or False"
    if kind in (int, float):
        number = "a whole number" if kind is int else "a number"
        fits = _is_number(value, kind, default, not_zero)
        return "" if fits else f"{number}, {_least(not_zero)}"
    return "" if isinstance(value, kind) else f"{kind.__name__}(...)"


def _expected_numbers(
    value: Any, kinds: tuple[Any, ...], default: tuple[float, ...], not_zero: bool
) -> str:
    """Say what a field of several numbers takes; empty if that includes the value."""
    lowest, of_any_length = min(default), Ellipsis in kinds
    if not_zero and isinstance(value, tuple) and not value:
        return "a tuple of at least one number"
    fits = isinstance(value, tuple) and (of_any_length or len(value) == len(kinds))
    if not fits or not all(_is_number(one, float, lowest, not_zero) for one in value):
        count = "" if of_any_length else f"{len(kinds)} "
        sign = "" if lowest < 0 else f", each {_least(not_zero)}"
        return f"a tuple of {count}numbers{sign}"
    if len(kinds) == 2 and not of_any_length and value[0] > value[1]:
        return "the lower and the upper end of a range"
    return ""


def _is_number(value: Any, kind: type, default: int | float, not_zero: bool) -> bool:
    """Return whether a value is a number of this kind, and negative only if the default is."""
    if isinstance(value, bool) or not isinstance(value, Integral if kind is int else Real):
        return False
    try:
        number = float(value)
    except OverflowError:  # no float is as large
        return False
    if np.isnan(number) or (not_zero and number == 0):
        return False
    return number >= 0 or default < 0


def _least(not_zero: bool) -> str:
    return "more than 0" if not_zero else "0 or more"
