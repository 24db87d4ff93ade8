"""COLMAP's camera models: half a pixel between the conventions, and a lens for each name."""

import numpy as np
import pytest

from catfree.adapters.calibration_files.colmap._colmap_models import (
    MODELS,
    PARAMETERS,
    intrinsics,
    supported_model,
)
from catfree.errors import FileFormatError
from catfree.types import Lens


@pytest.mark.parametrize("model", [name for name, _ in MODELS.values()])
def test_every_model_has_a_matrix_and_a_lens(model):
    value = {"f": 500.0, "fx": 500.0, "fy": 500.0, "cx": 320.5, "cy": 240.5, "k1": 0.1, "p2": 0.01}
    parameters = np.array([value.get(name, 0.0) for name in PARAMETERS[model]])
    K, coefficients, lens = intrinsics(model, parameters, "image a.jpg")
    np.testing.assert_array_equal(K, [[500, 0, 320], [0, 500, 240], [0, 0, 1]])
    names = PARAMETERS[model]
    expected = [0.1 * ("k1" in names), 0, 0, 0.01 * ("p2" in names), 0, 0, 0, 0]
    np.testing.assert_array_equal(coefficients, expected)
    assert (lens == Lens.FISHEYE) == ("FISHEYE" in model)


def test_other_models_are_refused_by_name():
    assert supported_model("OPENCV", 3) == "OPENCV"
    with pytest.raises(FileFormatError, match="camera 3 has the model FOV"):
        supported_model("FOV", 3)
