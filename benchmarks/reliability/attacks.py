"""Malicious files that try to crash, stall, exhaust memory or access other folders."""

import functools
import io
import json
import os
import pickle
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reliability.files import readers
from benchmarks.reliability.material import Material, Reader
from benchmarks.reliability.mutations import NUMBER, is_text
from benchmarks.reliability.tally import Tally
from catfree._run._cache import StageCache
from catfree.adapters import read_opencv_yaml, write_opencv_yaml
from catfree.methods._localize import localize
from catfree.types import Detections, Lens, Localization
from catfree.types._writing import ABANDONED_AFTER

DEEP = 20_000
DIGITS = b"9" * 5000
PLACES = 60  # numbers per file to replace, one at a time
ROW = "attacks"
ARCHIVES = (
    *("Detections.load", "Rig.load", "Scene.load", "Tracks.load", "TrackerState.load"),
    "read_results",
)
_XML = b"<opencv_storage><camera_matrix><data>&a;</data></camera_matrix></opencv_storage>"


class Bad:
    """Payload that a pickle would run."""

    def __reduce__(self) -> Any:
        return os.mkdir, ("/tmp/catfree_reliability_pickle_ran",)


def attack(tally: Tally, folder: Path) -> None:
    """Try every attack.

    Args:
        tally: counts the outcomes.
        folder: an empty folder to work in.
    """
    known = {reader.name: reader for reader in readers(0)}
    places: dict[str, Path] = {}

    def against(name: str, content: bytes, file: str | None = None) -> None:
        reader = known[name]
        if name not in places:
            places[name] = folder / f"reader_{len(places)}"
            places[name].mkdir()
            reader.write(places[name])
        place = places[name]
        path = _victim(reader, place, file)
        _replace(tally, reader, place, path, content, repr(content[:40]))

    for name in (*ARCHIVES, "cached Localization", "cached Detections"):
        for content in _archives():
            against(name, content)
    for name, make in (("read_scenario", "detections.npz"), ("read_uniform_json", "a.npz")):
        for content in _archives():
            against(name, content, make)
    for content in _tomls():
        against("read_anipose_toml", content)
        against("read_sites", content)
    for content in _yamls():
        against("read_opencv_yaml (YAML)", content)
    for content in _xmls(folder):
        against("read_opencv_yaml (XML)", content)
        against("read_wildtrack", content, "intr_CVLab1.xml")
        against("read_multiviewx", content, "intr_Camera1.xml")
    names = ("read_rig_json", "read_scene_json", "read_uniform_json", "read_anchors")
    for name in (*names, "read_scenario"):
        for content in _jsons():
            against(name, content, "rig.json" if name == "read_scenario" else None)
    for content in _jsons():
        against("read_opencv_yaml (JSON)", content)
    person = b'[{"personID": %s, "positionID": %s, "views": []}]'
    for number in (DIGITS, str(2**63).encode(), str(-(2**64)).encode(), b"1e400", b"1.5", b"true"):
        for content in (person % (number, b"5"), person % (b"5", number)):
            against("read_wildtrack", content, "00000000.json")
            against("read_multiviewx", content, "00001.json")
    for content in (b'"' + b"a" * 300_000, b"frame,id,x,y\n" + DIGITS + b",1,2,3\n", b"\0" * 999):
        against("read_tracks_csv", content)
        against("read_ground_truth", content)
    for content in (
        b"1,1,1e308,0,1e308,5\n",
        b"1,1,0,0,5,5," + DIGITS,
        b" " * 400_000,
        b"," * 9999,
    ):
        against("read_mot", content)
    for count in (2**32, 2**63, 2**64 - 1):
        head = struct.pack("<Q", count)
        for file in ("cameras.bin", "images.bin", "points3D.bin"):
            against("read_colmap (binary)", head, file)
            against("read_colmap (binary)", head + bytes(10_000), file)
    unnamed = struct.pack("<Qi7di", 2**40, 1, *[0.5] * 7, 1) + b"x" * 5000
    against("read_colmap (binary)", unnamed, "images.bin")
    for at, reader in enumerate(known.values()):
        place = folder / f"digits_{at}"
        place.mkdir()
        _long_numbers(tally, reader, place)
    _around_files(tally, folder)


def _long_numbers(tally: Tally, reader: Reader, place: Path) -> None:
    """Replace numbers in a reader's text files by one of 5000 digits: one by one, then all."""
    reader.write(place)
    for path in sorted(path for path in place.rglob("*") if path.is_file()):
        content = path.read_bytes()
        if not is_text(content) or (reader.only and path.suffix not in reader.only):
            continue
        found = list(NUMBER.finditer(content))
        chosen = np.unique(np.linspace(0, len(found) - 1, min(len(found), PLACES)).astype(int))
        attacks = [
            (f"number {at}", content[: found[at].start()] + DIGITS + content[found[at].end() :])
            for at in chosen
        ]
        if len(found) <= PLACES:
            attacks.append(("all numbers", NUMBER.sub(DIGITS, content)))
        for what, changed in attacks:
            _replace(tally, reader, place, path, changed, f"5000 digits for {what}")


def _replace(
    tally: Tally, reader: Reader, place: Path, path: Path, content: bytes, what: str
) -> None:
    """Read a reader's folder with other content in one file, then restore the file."""
    before = path.read_bytes()
    path.write_bytes(content)
    tally.attempt(
        ROW,
        lambda: reader.read(place),
        detail=f"{reader.name} {path.name}: {what}",
        folder=place,
        absent=reader.cached,
    )
    path.write_bytes(before)


def _victim(reader: Reader, place: Path, file: str | None) -> Path:
    files = [path for path in sorted(place.rglob("*")) if path.is_file()]
    return next(path for path in files if file in (None, path.name))


@functools.cache
def _archives() -> list[bytes]:
    """Make archives that need more memory than there is, or contain other things than arrays."""
    contents = [b"PK\x05\x06" + bytes(18), pickle.dumps(Bad()), b"\x93NUMPY\x01\x00"]
    shapes = ("(1000000000000,)", "(4611686018427387904, 4)", "(-1,)", "(0, 10**99)", "(2.5,)")
    types = ("'|O'", "'<U2000000000'", "'|V0'", "[" * 900, "'(9,9,9,9,9)f8'", "'<f99'")
    asked = [("'<f8'", shape) for shape in shapes] + [(kind, "(3,)") for kind in types]
    contents += [
        _member(f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}}}")
        for kind, shape in asked
    ]
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        header = _npy("{'descr': '|u1', 'fortran_order': False, 'shape': (276824064,)}")
        with archive.open("frame.npy", "w") as stream:
            stream.write(header)
            for _ in range(264):
                stream.write(bytes(2**20))
    contents.append(bomb.getvalue())
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("frame.npy", bytes(2**22))
    contents.append(packed.getvalue())
    pickled = io.BytesIO()
    np.savez(pickled, frame=np.array([Bad()], object))
    return [*contents, pickled.getvalue()]


def _npy(header: str) -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _member(header: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in ("frame", "camera", "box", "K", "R", "t", "sigma", "catfree_kind"):
            archive.writestr(f"{name}.npy", _npy(header) + bytes(24))
    return stream.getvalue()


def _tomls() -> list[bytes]:
    camera = b'name = "a"\nsize = [9, 9]\nmatrix = [[9, 0, 4], [0, 9, 4], [0, 0, 1]]\n'
    camera += b"rotation = [0, 0, 0]\ntranslation = [0, 0, 0]\n"
    return [
        b"x = " + b"[" * DEEP,
        b"x = " + b"{a = " * DEEP,
        b"x = " + DIGITS,
        b".".join([b"a"] * DEEP) + b" = 1",
        b"[" + b".".join([b"a"] * DEEP) + b"]",
        b'x = "' + b"\\" * DEEP,
        b"x = '''" + b"'" * DEEP,
        (b"a.b.c.d = 1\n" * 60_000),
        b"\n".join(b"[[a.b%d.c]]" % at for at in range(20_000)),
        b"[cam_0]\n" + camera + b"[cam_1]\n" + camera,
        b"[cam_0]\n" + camera.replace(b'"a"', b'"\\ud800"'),
        b"[cam_0]\n" + camera.replace(b'"a"', b"[1, 2]"),
        b"[cam_0]\n" + camera.replace(b"[9, 9]", b"[nan, inf]"),
        b"[cam_0]\n" + camera.replace(b"[9, 9]", b"[9223372036854775808, 9]"),
        b"[cam_0]\n" + camera.replace(b"[0, 0, 0]", b"[1e308, 1e308, 1e308]"),
        b"[" + b"k" * 5000 + b"]\nmatrix = 1\n",
    ]


def _yamls() -> list[bytes]:
    matrix = b"%YAML:1.0\n---\nK: !!opencv-matrix\n   "
    return [
        matrix + b"data:[" * DEEP,
        matrix + b"data: " * DEEP,
        matrix + b"data:" + b" " * 400_000,
        matrix + b"]" * DEEP + b"data: [",
        b"K: " + b"[" * DEEP,
        b"K: [" + DIGITS + b"]\n",
        b"a" * 400_000,
        b"K:\n" + b"   - 1\n" * 100_000,
        b"K: !!python/object/apply:os.system ['true']\n",
        b"K: &a [1, 2]\nR: *a\n" * 2000,
        b"%YAML:1.0\n" * 20_000,
    ]


def _xmls(folder: Path) -> list[bytes]:
    secret = folder / "secret.txt"
    secret.write_text("1 0 0 0 1 0 0 0 1")
    laughs = b"".join(b'<!ENTITY a%d "%s">' % (at, b"&a%d;" % (at + 1) * 10) for at in range(1, 10))
    return [
        b"<!DOCTYPE x [" + laughs + b'<!ENTITY a10 "9 "><!ENTITY a "&a1;">]>' + _XML,
        b'<!DOCTYPE x [<!ENTITY a "%s">]>' % (b"9 " * 50_000) + _XML.replace(b"&a;", b"&a;" * 5000),
        b'<!DOCTYPE x [<!ENTITY a SYSTEM "file://%s">]>' % str(secret).encode() + _XML,
        b"<a>" * 100_000,
        b"<a>" * DEEP + b"</a>" * DEEP,
        b"<opencv_storage><camera_matrix>" + DIGITS + b"</camera_matrix></opencv_storage>",
        b"<?xml version='1.0' encoding='utf-99'?>" + _XML.replace(b"&a;", b"1"),
        b"<x " + b"a" * 300_000 + b"='1'/>",
        b"<!--" + b"-" * 300_000,
    ]


def _jsons() -> list[bytes]:
    return [
        b"[" * 200_000,
        b'{"a":' * 200_000,
        b'{"units": ' + DIGITS + b"}",
        b'{"units": "m", "cameras": [{"name": "\\ud800"}], "frames": []}',
        b'{"units": "' + b"u" * 5000 + b'"}',
        b'{"units": "m", "cameras": "' + b"u" * 5000 + b'"}',
        b'{"units": {"a": [' + b"[" * 500 + b"]" * 500 + b"]}}",
        b'{"units": "m", "cameras": [{"name": ' + b"[" * 500 + b"]" * 500 + b"}]}",
        b'{"units": "m", "cameras": [{"name": "a", "K": [[NaN, 0, 0], [0, 1, 0], [0, 0, 1]]}]}',
        b'{"K": [1e999], "units": NaN}',
        json.dumps({"units": "m", "cameras": [{"name": "a" * 5000}] * 2, "frames": []}).encode(),
        b"null",
        b"[]",
        b'"' + b"a" * 300_000,
        b"\xef\xbb\xbf{}",
        b"\xff\xfe{\x00}\x00",
    ]


def _localize_at(frame: np.ndarray, m: Material) -> Localization:
    boxes = m.detections
    return localize(Detections(frame, boxes.camera, boxes.box, boxes.score), m.scene)


def _around_files(tally: Tally, folder: Path) -> None:
    """Try attacks that do not depend on the content of a file."""
    m = Material(0)

    def quietly(action: Callable[[], Any], detail: str) -> None:
        tally.attempt(ROW, action, detail=detail, folder=folder)

    far = m.detections.frame.copy()
    far[len(far) // 2 :] += 2**62
    for shift in (0, 2**62):
        frame = np.where(m.detections.frame < 4, m.detections.frame - shift, far)
        quietly(functools.partial(_localize_at, frame, m), f"frames {shift} apart")
    for path in ("x" * 300, "\0", "x/" * 3000, "\ud800"):
        for reader in (Detections.load, read_opencv_yaml):
            quietly(lambda path=path, reader=reader: reader(path), f"path {path[:9]!a}")
    four = folder / "four"
    four.mkdir()
    (calibration,) = write_opencv_yaml(four, m.lens_rig().select([0]), ["a"])
    text = calibration.read_text()
    assert "0.002, 0.0 ]" in text
    calibration.write_text(text.replace("rows: 5", "rows: 4").replace("0.002, 0.0 ]", "0.002 ]"))
    before = tally.rows[ROW]["clean error"]
    quietly(lambda: read_opencv_yaml(calibration), "four coefficients of any lens")
    if tally.rows[ROW]["clean error"] == before:
        tally.count(ROW, "loss", "four coefficients read as those of a pinhole")
    unstated = calibration.read_text()
    for statement in ("fisheye_model: 1\n", "distortion_model: equidistant\n"):
        calibration.write_text(unstated + statement)
        tally.attempt(
            ROW,
            lambda: read_opencv_yaml(calibration),
            detail=f"four coefficients, {statement}",
            folder=folder,
            same=lambda found: bool((found.rig.lenses == Lens.FISHEYE).all()),
        )
    foreign = folder / "foreign"
    foreign.mkdir()
    kept = [".thesis.npz.bak", ".data.npz.Ab12Cd", "a.npz", ".x.npz", ".catfree-" + "g" * 32]
    past = time.time() - 2 * ABANDONED_AFTER
    for name in kept:
        (foreign / name).write_text("mine")
        os.utime(foreign / name, (past, past))
    StageCache(foreign).load("a", "b", Localization)
    for name in kept:
        if not (foreign / name).exists():
            tally.count(ROW, "loss", f"the cache deleted {name}")
    if Path("/tmp/catfree_reliability_pickle_ran").exists():
        tally.count(ROW, "loss", "a pickle was run")
