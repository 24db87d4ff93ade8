"""Checks of stored results: columns of equal length, numbers in range."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import AbstractArray, jaxtyped

from catfree.errors import InvalidInputError, quoted
from catfree.types._results import Fate, Localization, Origin, Tracks
from catfree.types._validation import first_index, require_finite


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


def require_sound_tracks(tracks: Tracks) -> None:
    """Raise unless tracks are finite, with lengths and probabilities in range.

    A position that fewer than two cameras support may have an infinite sigma.

    Raises:
        InvalidInputError: naming the first column and row.
    """
    unknown = np.isposinf(tracks.sigma) & (tracks.supporting_cameras < 2)
    for name in ("position", "ground_xy", "existence"):
        if getattr(tracks, name) is not None:
            require_finite(getattr(tracks, name), name)
    for name in ("sigma", "covariance"):
        require_finite(getattr(tracks, name), name, ~unknown)
    _require((np.asarray(tracks.sigma) >= 0), tracks.sigma, "sigma", "a length")
    _require(np.isin(tracks.origin, list(Origin)), tracks.origin, "origin", "a known origin")
    if tracks.existence is not None:
        existence = np.asarray(tracks.existence)
        _require((existence >= 0) & (existence <= 1), existence, "existence", "a probability")


def require_sound_localization(localization: Localization) -> None:
    """Raise unless `localize` could have returned this result.

    Raises:
        InvalidInputError: naming the first field or row.
    """
    require_sound_tracks(localization.tracks)
    candidates = localization.candidates
    for name in ("position", "ground_distance", "score"):
        require_finite(getattr(candidates, name), f"candidates.{name}")
    _require(~np.isnan(candidates.sigma), candidates.sigma, "candidates.sigma", "a length")
    _require(np.isin(candidates.fate, list(Fate)), candidates.fate, "candidates.fate", "a fate")


def _is_array_type(option: Any) -> bool:
    return isinstance(option, type) and issubclass(option, AbstractArray)


def _require(good: Any, values: Any, name: str, meaning: str) -> None:
    if not np.all(good):
        at = first_index(~good)
        raise InvalidInputError(f"{name}[{at}] is {quoted(values[~good][0])}, not {meaning}.")
