"""COLMAP's binary files, written here byte by byte from the format's description."""

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.adapters import read_colmap, write_colmap_text
from catfree.errors import CatFreeError, FileFormatError
from catfree.types import Lens, Rig

MODELS = {
    0: [500.0, 320.5, 240.5],
    1: [500.0, 510.0, 320.5, 240.5],
    2: [500.0, 320.5, 240.5, 0.1],
    3: [500.0, 320.5, 240.5, 0.1, -0.2],
    4: [500.0, 510.0, 320.5, 240.5, 0.1, -0.2, 0.003, 0.004],
    5: [500.0, 510.0, 320.5, 240.5, 0.1, -0.2, 0.003, 0.004],
    6: [500.0, 510.0, 320.5, 240.5, 0.1, -0.2, 0.003, 0.004, 0.5, 0.6, 0.7, 0.8],
    8: [500.0, 320.5, 240.5, 0.1],
    9: [500.0, 320.5, 240.5, 0.1, -0.2],
}
LENSES = {2: [0.1], 3: [0.1, -0.2], 8: [0.1], 9: [0.1, -0.2]}
LENSES |= {model: [0.1, -0.2, 0.003, 0.004] for model in (4, 5)}
LENSES |= {6: [0.1, -0.2, 0.003, 0.004, 0.5, 0.6, 0.7, 0.8]}


def write_binary(folder: Path, models: list[int], observations: int = 2) -> None:
    """Write one image per camera model, `view<k>.jpg`, at translation (k, 0, 5), and two points."""
    cameras = struct.pack("<Q", len(models))
    images = struct.pack("<Q", len(models))
    for at, model in enumerate(models):
        cameras += struct.pack("<iiQQ", 10 + at, model, 640, 480)
        parameters = MODELS.get(model, [1.0])
        cameras += struct.pack(f"<{len(parameters)}d", *parameters)
        images += struct.pack("<i7di", 20 + at, 1, 0, 0, 0, at, 0, 5, 10 + at)
        images += f"view{at}.jpg".encode() + b"\0" + struct.pack("<Q", observations)
        images += struct.pack("<ddq", 1.5, 2.5, -1) * observations
    points = struct.pack("<Q", 2)
    for at in (1, 2):
        points += struct.pack("<Q3d3BdQ", at, at, 2, 3, 255, 0, 0, 0.5, 1) + struct.pack(
            "<ii", 20, 0
        )
    for name, content in (("cameras", cameras), ("images", images), ("points3D", points)):
        (folder / f"{name}.bin").write_bytes(content)


def test_every_supported_model(tmp_path):
    write_binary(tmp_path, list(MODELS))
    named = read_colmap(tmp_path)
    assert named.names == tuple(f"view{at}.jpg" for at in range(len(MODELS)))
    rig = named.rig
    for at, model in enumerate(MODELS):
        vertical = 510 if model in (1, 4, 5, 6) else 500
        np.testing.assert_array_equal(rig.K[at], [[500, 0, 320], [0, vertical, 240], [0, 0, 1]])
        assert rig.distortion is not None
        lens = LENSES.get(model, [])
        np.testing.assert_array_equal(rig.distortion[at], lens + [0] * (8 - len(lens)))
        assert rig.lenses[at] == (Lens.FISHEYE if model in (5, 8, 9) else Lens.PINHOLE)
        np.testing.assert_array_equal(rig.t[at], [at, 0, 5])
    np.testing.assert_array_equal(rig.image_size, [[640, 480]] * len(MODELS))
    np.testing.assert_array_equal(named.points, [[1, 2, 3], [2, 2, 3]])


def test_images_come_in_natural_order(tmp_path):
    write_binary(tmp_path, [1] * 3)
    rig = read_colmap(tmp_path).rig
    named = read_colmap(write_colmap_text(tmp_path / "text", rig, ["c10.png", "c2.png", "c1.png"]))
    assert named.names == ("c1.png", "c2.png", "c10.png")
    np.testing.assert_array_equal(named.rig.t, np.asarray(rig.t)[::-1])


def test_text_and_binary_agree(tmp_path):
    binary, text = tmp_path / "binary", tmp_path / "text"
    binary.mkdir()
    write_binary(binary, [1, 4, 5, 6, 9], observations=0)
    named = read_colmap(binary)
    write_colmap_text(text, named.rig, named.names, named.points)
    again = read_colmap(text)
    assert again.names == named.names
    for name in ("K", "R", "t", "image_size", "distortion", "lens"):
        np.testing.assert_array_equal(getattr(again.rig, name), getattr(named.rig, name))
    np.testing.assert_array_equal(again.points, named.points)


@pytest.mark.parametrize("bits", [0x7FF0000000000001, 0x7FF8000000000000, 0x7FF0000000000000])
def test_a_rotation_that_is_none_is_refused_without_a_warning(bits, tmp_path):
    write_binary(tmp_path, [0, 4])
    content = bytearray((tmp_path / "images.bin").read_bytes())
    struct.pack_into("<Q", content, 12, bits)  # a signaling NaN, a quiet one, and infinity
    (tmp_path / "images.bin").write_bytes(bytes(content))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(CatFreeError, match=r"view0\.jpg has no valid rotation quaternion"):
            read_colmap(tmp_path)


@pytest.mark.slow
@given(
    file=st.sampled_from(["cameras.bin", "images.bin", "points3D.bin"]),
    where=st.floats(0, 1, exclude_max=True),
)
def test_a_file_cut_anywhere_is_named(file, where, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cut")
    write_binary(folder, [0, 4])
    content = (folder / file).read_bytes()
    (folder / file).write_bytes(content[: int(where * len(content))])
    with pytest.raises(FileFormatError, match=file.replace(".", r"\.")):
        read_colmap(folder)


@pytest.mark.slow
@given(
    file=st.sampled_from(["cameras.bin", "images.bin", "points3D.bin"]),
    where=st.floats(0, 1, exclude_max=True),
    junk=st.binary(min_size=1, max_size=8),
)
def test_damaged_bytes_raise_only_our_errors(file, where, junk, tmp_path_factory):
    folder = tmp_path_factory.mktemp("damaged")
    write_binary(folder, [0, 4])
    content = bytearray((folder / file).read_bytes())
    at = int(where * len(content))
    content[at : at + len(junk)] = junk
    (folder / file).write_bytes(bytes(content))
    try:
        result = read_colmap(folder).rig
    except CatFreeError as error:
        result = str(error)
    assert isinstance(result, Rig) or str(folder) in result


@pytest.mark.parametrize("model", [7, 10, 99])
def test_other_models_are_refused(model, tmp_path):
    write_binary(tmp_path, [model])
    with pytest.raises(FileFormatError, match=f"camera 10 has the model number {model}"):
        read_colmap(tmp_path)
