"""Calibrations that could be read as something else than they are meant to be."""

import numpy as np
import pytest

from catfree.adapters import (
    read_anipose_toml,
    read_opencv_yaml,
    write_anipose_toml,
    write_opencv_yaml,
)
from catfree.errors import InvalidInputError
from catfree.synthetic import make_layout

NAMES = ("a", "b", "c", "d")


@pytest.fixture
def rig():
    return make_layout("ring4", 0).rig


@pytest.mark.parametrize("unit", [0.0, -0.001, np.nan])
def test_a_unit_is_a_positive_length(unit, rig, tmp_path):
    toml = write_anipose_toml(tmp_path / "calibration.toml", rig, NAMES)
    before = toml.read_bytes()
    yaml = write_opencv_yaml(tmp_path, rig, NAMES)
    for use in (
        lambda: read_anipose_toml(toml, metres_per_unit=unit),
        lambda: read_opencv_yaml(yaml, metres_per_unit=unit),
        lambda: write_anipose_toml(toml, rig, NAMES, metres_per_unit=unit),
    ):
        with pytest.raises(InvalidInputError, match=r"metres_per_unit is .* positive number"):
            use()
    assert toml.read_bytes() == before
