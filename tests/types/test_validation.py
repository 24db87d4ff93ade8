"""Wrong arguments are named in one sentence before anything is computed with them."""

import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from catfree.errors import InvalidInputError
from catfree.types import Detections
from catfree.types.validation import as_boolean, as_float, as_integer, require_instance

# Without the import hook of these tests, which would object to the types first.
SWAPPED = """
import numpy as np
import catfree as cf

rig = cf.Rig(
    np.tile([[900.0, 0, 960], [0, 900, 540], [0, 0, 1]], (2, 1, 1)),
    np.tile([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], (2, 1, 1)),
    [[0.0, 3, 0], [1, 3, 0]],
    (1920, 1080),
)
ground = cf.Plane([0, 0, 1], 0)
scene = cf.Scene(rig, ground, 10.0)
people = cf.Detections([0, 0], [0, 1], [[0, 0, 10, 20.0]] * 2)
calls = {
    "Settings, no such method": lambda: cf.Settings(method="Paper"),
    "Scene, swapped": lambda: cf.Scene(ground, rig, 10.0),
    "Scene, no ground": lambda: cf.Scene(rig, None, 10.0),
    "localize, swapped": lambda: cf.localize(scene, people),
    "localize, a rig": lambda: cf.localize(people, rig),
    "localize, a name": lambda: cf.localize(people, scene, "paper"),
    "calibrate, nothing": lambda: cf.calibrate(None, (1920, 1080)),
    "calibrate, a name": lambda: cf.calibrate(people, (1920, 1080), "paper"),
    "refine, swapped": lambda: cf.refine(scene, people),
    "coverage, a rig": lambda: cf.coverage(rig),
    "run, a path as scene": lambda: cf.run(["a.mp4", "b.mp4"], scene="scene.npz"),
    "run, a name as detector": lambda: cf.run(["a.mp4", "b.mp4"], detector="yolo"),
}
for name, call in calls.items():
    try:
        call()
    except cf.CatFreeError as error:
        assert " must be a" in str(error), f"{name}: {error}"
    else:
        raise AssertionError(name)
"""


def test_public_functions_name_arguments_of_another_type():
    done = subprocess.run([sys.executable, "-c", SWAPPED], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_instances_are_named_by_argument_and_type():
    require_instance(Detections([], [], []), Detections, "detections")
    with pytest.raises(InvalidInputError, match="detections must be a Detections, got list"):
        require_instance([], Detections, "detections")


@pytest.mark.parametrize(
    "read", [as_float, lambda v: as_integer(v, "frame"), lambda v: as_boolean(v, "registered")]
)
def test_lists_of_different_lengths_are_no_array(read):
    with pytest.raises(InvalidInputError, match="different lengths"):
        read([[0, 1], [1]])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.array([3, 2**64 - 1], np.uint64), r"frame\[1\] is 18446744073709551615"),
        (np.array(2**63, np.uint64), "frame is 9223372036854775808"),
        ([[0.0, 1.5]], r"frame\[0, 1\] is 1.5; it must be a whole number"),
        (np.array([1 + 2j]), "frame must hold whole numbers, got dtype complex128"),
    ],
)
def test_whole_numbers_that_int64_cannot_hold_are_refused(value, message):
    with pytest.raises(InvalidInputError, match=message):
        as_integer(value, "frame")


def test_numbers_up_to_63_bits_stay_what_they_are():
    for value in (2**63 - 1, np.uint64(2**63 - 1), -(2**63)):
        assert as_integer([value], "frame")[0] == value


def test_imaginary_parts_are_not_dropped():
    for value in ([1j], np.array([1 + 0j]), jnp.array([1j]), np.array(["2020"], "datetime64[Y]")):
        with pytest.raises(InvalidInputError, match="Expected real numbers"):
            as_float(value)


def test_empty_lists_are_detections_without_rows():
    nobody = Detections([], [], [], [], [], [], [])
    assert len(nobody) == 0
    assert nobody.keypoints is not None
    assert nobody.keypoints.shape == (0, 17, 3)
    assert nobody.embedding is not None
    assert nobody.embedding.shape == (0, 0)
