"""Validation of the arrays of a `TrackerState` that a tracker is to continue from."""

import functools
import typing
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import jaxtyped

from catfree.errors import InvalidInputError, quoted
from catfree.types import Detections
from catfree.types._validation import (
    options_of,
    refuse,
    require_known_cameras,
    require_shape,
)

LARGEST = 2.0**53  # larger whole numbers are not exact as floats; no other number comes near
_DTYPES = ("bool", "int32", "int64", "float32", "float64")
_UNKNOWN_AT_FIRST = ("unit", "step", "usual", "final_time")  # NaN until it is learned
_POSITIVE = ("unit", "step", "edge", "angular", "spread", "density")
_SLACK = 1.2  # squared correlations may exceed 1 by rounding
_LEAST = {"support": -1, "group": -1, "spacing": 1} | dict.fromkeys(
    (
        *("scene", "count", "tracks", "names", "name", "track", "gap", "boxes"),
        *("heights", "trials", "hits", "clutter", "steps", "habits", "place"),
    ),
    0,
)
_PICTURES = ("missing", "silent")  # records whose second column is a camera


def require_sound_arrays(
    arrays: Mapping[str, np.ndarray], like: Any, sizes: Mapping[str, int], where: str = ""
) -> None:
    """Raise unless all arrays of a record have the declared types and shapes, and valid numbers.

    Args:
        arrays: arrays by path, such as `.learned.unit` or `.window[2].time`.
        like: a record with the same parts: a dataclass or named tuple with jaxtyping annotations;
            its numbers are not used.
        sizes: lengths of axes by name, such as the number of cameras; the first array of a record
            defines any other axis.
        where: the path of the record.

    Raises:
        InvalidInputError: naming the first array.
    """
    lengths = dict(sizes)
    for field, hint in _hints(type(like)).items():
        part, name = getattr(like, field), f"{where}.{field}"
        if type(part) is tuple:
            for at, item in enumerate(part):
                require_sound_arrays(arrays, item, sizes, f"{name}[{at}]")
        elif part is not None and not isinstance(part, np.ndarray):
            require_sound_arrays(arrays, part, sizes, name)
        elif name in arrays:
            _require_array(arrays[name], options_of(hint)[0], name[1:], lengths)
            _require_numbers(arrays[name], field, name[1:], sizes["cam"])
        elif type(None) not in options_of(hint):
            raise InvalidInputError(f"{name[1:]} is missing.")
    if isinstance(like, Detections):
        boxes = Detections(**{name: arrays.get(f"{where}.{name}") for name in vars(like)})
        require_known_cameras(boxes.camera, sizes["cam"])


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def _require_array(value: np.ndarray, hint: Any, name: str, lengths: dict[str, int]) -> None:
    """Raise unless an array has the declared type and shape; record the lengths of new axes."""
    axes = hint.dim_str.split()
    if value.ndim == len(axes):
        for axis, length in zip(axes, value.shape, strict=True):
            lengths.setdefault(axis, length)
    shape = tuple(int(axis) if axis.isdigit() else lengths.get(axis) for axis in axes)
    require_shape(value, shape, name)
    with jaxtyped("context"):  # keep these axis names separate from those in a caller's annotations
        is_of_kind = isinstance(value, hint)
    if value.dtype not in _DTYPES or not is_of_kind:
        raise InvalidInputError(f"{name} has type {quoted(value.dtype)}.")


def _require_numbers(value: np.ndarray, field: str, name: str, cameras: int) -> None:
    """Raise at the first number in an array that no tracker could have."""
    good = (value > -LARGEST) & (value < LARGEST)
    if name == "time":  # minus infinity before the first instant
        good |= np.isneginf(value)
    if field in _UNKNOWN_AT_FIRST:
        good |= np.isnan(value)
    if field in _POSITIVE:
        good &= ~(value < 1 / LARGEST)
    if field == "likeness":
        good[:, 1] &= value[:, 1] > 1 / LARGEST  # the standard deviations
    if field in _LEAST:
        good &= value >= _LEAST[field]
    if field == "group":
        good &= value < len(value)
    if field in ("track", "times") or name == "heads.name":
        good[1:] &= np.diff(value) > 0
    if field.endswith("covariance"):
        within = np.where(good, value, 0.0)
        variance = np.diagonal(within, axis1=1, axis2=2)
        good &= within**2 <= _SLACK * variance[:, :, None] * variance[:, None]
        good &= (variance > 0)[:, None]
    if field in _PICTURES:
        good[:, 1] &= (value[:, 1] >= 0) & (value[:, 1] < cameras)
    refuse(~good, value, name, ", which no tracker has there.")
