"""Matrices in OpenCV XML files, including those with bare text that OpenCV itself cannot read."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from catfree.adapters.documents import StrPath, numbers, read_text
from catfree.errors import FileFormatError, InvalidInputError


def read_xml_matrices(
    path: StrPath, meaning: str, shapes: dict[str, tuple[int, ...]]
) -> dict[str, np.ndarray]:
    """Some matrices of an OpenCV XML file.

    A matrix is `<name type_id="opencv-matrix"><rows/><cols/><dt/><data>numbers</data></name>` or
    just `<name>numbers</name>`.

    Args:
        path: the file.
        meaning: what it is, for messages: `intrinsics of camera C1`.
        shapes: wanted names and their shapes.

    Returns:
        Name to float64 array.

    Raises:
        InvalidInputError: if there is no such file or a number is not finite.
        FileFormatError: if it is no XML (as when truncated) or lacks one of the matrices.
    """
    source = Path(path)
    text = read_text(source, meaning)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise FileFormatError(
            f"{source} ({meaning}) is not valid XML ({error}). Is the file complete?"
        ) from error
    matrices = {}
    for name, shape in shapes.items():
        node = root.find(name)
        if node is None:
            raise FileFormatError(f"{source} ({meaning}) has no <{name}>.")
        data = node.find("data")
        words = ((node if data is None else data).text or "").split()
        matrices[name] = numbers(words, shape, source, f"<{name}>")
        if not np.isfinite(matrices[name]).all():
            raise InvalidInputError(f"{source} ({meaning}): <{name}> is not finite.")
    return matrices


def rotation_from_vector(vector: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of a (3,) rotation vector in radians (OpenCV's Rodrigues vector)."""
    return Rotation.from_rotvec(vector).as_matrix()


def rotation_to_vector(rotation: np.ndarray) -> np.ndarray:
    """(3,) rotation vector in radians, at most pi long, of a (3, 3) rotation."""
    return Rotation.from_matrix(rotation).as_rotvec()
