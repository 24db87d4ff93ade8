"""`Reconstruction`: refused input and default values."""

import numpy as np
import pytest

from catfree.adapters import Reconstruction as PublicReconstruction
from catfree.errors import InvalidInputError
from catfree.types.results._reconstruction import Reconstruction
from tests.types.camera_parameters import parameters


def given(**change) -> dict:
    cameras = {name: value for name, value in parameters().items() if name != "image_size"}
    return cameras | {"points": np.zeros((4, 3)), "confidence": np.ones(4)} | change


def test_all_views_are_registered_unless_said_otherwise():
    found = Reconstruction(**given())
    assert found.registered.all()
    assert not found.scale_is_metric
    assert Reconstruction(**given(points=[], confidence=[])).points.shape == (0, 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"R": np.zeros((2, 3, 3))}, "R must have shape"),
        ({"t": 5.0}, r"t must have shape \(n, 3\), got \(\)"),
        ({"t": np.full((3, 3), np.nan)}, r"t\[0, 0\] is not finite"),
        ({"confidence": np.ones(3)}, "confidence must have shape"),
        ({"K": np.tile(np.diag([1.0, 0, 1]), (3, 1, 1))}, r"K\[0\] has a focal length"),
        ({"R": np.tile(np.diag([1.0, 1, -1]), (3, 1, 1))}, r"R\[0\] is not a rotation"),
    ],
)
def test_what_a_reconstruction_refuses(change, message):
    with pytest.raises(InvalidInputError, match=message):
        Reconstruction(**given(**change))


def test_reconstructors_know_it_by_the_name_of_the_adapters():
    assert PublicReconstruction is Reconstruction
