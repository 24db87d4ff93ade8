"""Values that all settings refuse."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import settings
from catfree.errors import InvalidInputError
from catfree.settings import (
    CalibrationSettings,
    EvidenceSettings,
    SelectionSettings,
)

CLASSES = [
    value
    for value in vars(settings).values()
    if isinstance(value, type) and dataclasses.is_dataclass(value)
]
NUMBERS = [
    (kind, field.name)
    for kind in CLASSES
    for field in dataclasses.fields(kind)
    if isinstance(field.default, int | float) and not isinstance(field.default, bool)
]
RANGES = [
    (kind, field.name)
    for kind in CLASSES
    for field in dataclasses.fields(kind)
    if field.type == tuple[float, float]
]


def test_every_class_and_number_is_covered() -> None:
    assert len(CLASSES) == 9
    assert (EvidenceSettings, "gate") in NUMBERS
    assert (EvidenceSettings, "cover_ramp") in RANGES


@given(
    st.sampled_from(NUMBERS),
    st.integers(max_value=-1),
    st.floats(max_value=0, exclude_max=True) | st.just(np.nan),
)
def test_numbers_below_zero_and_nan_are_named(
    field: tuple[type, str], whole: int, number: float
) -> None:
    kind, name = field
    value = whole if isinstance(getattr(kind(), name), int) else number
    least = "more than 0" if name in kind.not_zero else "0 or more"
    with pytest.raises(InvalidInputError, match=rf"^{kind.__name__}\.{name} is .*number, {least}"):
        kind(**{name: value})


@given(st.sampled_from(RANGES), st.floats(0.01, 0.5), st.floats(0.51, 1))
def test_ranges_end_after_they_begin(field: tuple[type, str], low: float, high: float) -> None:
    kind, name = field
    assert getattr(kind(**{name: (low, high)}), name) == (low, high)
    with pytest.raises(InvalidInputError, match=rf"{name} is .* the upper end of a range"):
        kind(**{name: (high, low)})


def test_lenses_may_bend_inwards_but_not_be_nan() -> None:
    assert CalibrationSettings(bent_lenses=(-0.2, 0.1, -0.3)).bent_lenses[2] == -0.3
    with pytest.raises(InvalidInputError, match=r"bent_lenses is .*; it must be a tuple"):
        CalibrationSettings(bent_lenses=(np.nan,))


def test_what_may_be_none_may_not_be_anything() -> None:
    assert SelectionSettings(fixed_quantile=0.5).fixed_quantile == 0.5
    with pytest.raises(InvalidInputError, match="it must be None or a number, 0 or more"):
        SelectionSettings(fixed_quantile=-0.5)


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind in CLASSES for name in sorted(kind.shares)]
)
def test_shares_are_at_most_one(kind: type, name: str) -> None:
    most, more = ((0.5, 1.0), (0.5, 1.1)) if (kind, name) in RANGES else (1.0, 30.0)
    assert getattr(kind(**{name: most}), name) == most
    with pytest.raises(InvalidInputError, match=rf"{name} is .*; it must be at most 1"):
        kind(**{name: more})


@pytest.mark.parametrize(
    ("settings", "name", "value"),
    [
        (SelectionSettings(), "gates", np.array("none")),
        (SelectionSettings(), "gates", np.array(["none", "support"])),
        (CalibrationSettings(), "focal_shares", np.array([0.5, 0.7])),
    ],
)
def test_arrays_are_neither_options_nor_tuples(settings: Any, name: str, value: object) -> None:
    object.__setattr__(settings, name, value)  # the types of arguments are checked in tests
    with pytest.raises(InvalidInputError, match=rf"{name} is array.*; it must be (one of|a tuple)"):
        settings.__post_init__()


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind in CLASSES for name in sorted(kind.not_zero)]
)
def test_what_divides_is_not_zero(kind: type, name: str) -> None:
    default = getattr(kind(), name)
    nothing = (0.0,) * len(default) if isinstance(default, tuple) else type(default)(0)
    with pytest.raises(InvalidInputError, match=rf"{name} is .*; it must be .*more than 0"):
        kind(**{name: nothing})


def test_something_to_try_is_needed() -> None:
    assert CalibrationSettings(bent_lenses=()).bent_lenses == ()
    with pytest.raises(InvalidInputError, match=r"focal_shares is \(\); .* at least one number"):
        CalibrationSettings(focal_shares=())
