"""WildTrack and MultiviewX in their publishers' layouts, written here for known people."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from catfree.adapters import MultiViewSequence, read_multiviewx, read_uniform_json, read_wildtrack
from catfree.errors import CatFreeError, FileFormatError, InvalidInputError
from catfree.types import Rig

WILDTRACK_CAMERAS = ("CVLab1", "CVLab2", "CVLab3", "CVLab4", "IDIAP1", "IDIAP2", "IDIAP3")
INTRINSICS = np.array([[1000.0, 0, 960.5], [0, 1010, 540.25], [0, 0, 1]])
LENS = [-0.1, 0.2, 0.001, 0.002, -0.05]
HEIGHT, RADIUS = 1.8, 0.25  # size of an annotated cylinder in meters


def rig_around(x: float, y: float, count: int) -> Rig:
    """Place cameras 3 m high on a circle of 15 m radius, looking at (x, y)."""
    angle = 2 * np.pi * np.arange(count) / count + 0.2
    center = np.array([x, y, 0]) + np.stack(
        [15 * np.cos(angle), 15 * np.sin(angle), np.full(count, 3.0)], -1
    )
    forward = np.array([x, y, 0]) - center
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    K = np.tile(INTRINSICS, (count, 1, 1))
    return Rig(K, R, -np.einsum("cij,cj->ci", R, center), (1920, 1080))


def view(rig: Rig, camera: int, xy: np.ndarray) -> dict:
    """Annotate a cylinder at `xy`, with all values -1 if it is not in the image."""
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = xy + RADIUS * np.stack([np.cos(angle), np.sin(angle)], -1)
    points = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (0.0, HEIGHT)])
    seen = points @ rig.R[camera].T + rig.t[camera]
    pixel = (seen @ rig.K[camera].T)[:, :2] / seen[:, 2:]
    low, high = pixel.min(0).round().astype(int), pixel.max(0).round().astype(int)
    inside = (seen[:, 2] > 0).all() and (high > 0).all() and (low < [1920, 1080]).all()
    corners = [*low.tolist(), *high.tolist()] if inside else [-1] * 4
    return {"viewNum": camera} | dict(zip(("xmin", "ymin", "xmax", "ymax"), corners, strict=True))


def xml(**matrices: str) -> str:
    inner = "".join(f"<{name}>{text}</{name}>" for name, text in matrices.items())
    return f'<?xml version="1.0"?>\n<opencv_storage>{inner}</opencv_storage>\n'


def data(values: np.ndarray | list) -> str:
    text = " ".join(repr(float(v)) for v in np.ravel(values))
    return f"<rows>1</rows><cols>1</cols><dt>d</dt><data>\n {text}</data>"


def write_annotations(path: Path, people: dict[int, int], views) -> None:
    path.parent.mkdir(exist_ok=True)
    content = [
        {"personID": person, "positionID": cell, "views": views(cell)}
        for person, cell in people.items()
    ]
    path.write_text(json.dumps(content))


def wildtrack_position(cell: int) -> np.ndarray:
    return np.array([-3 + 0.025 * (cell % 480), -9 + 0.025 * (cell // 480)])


WILDTRACK_PEOPLE = {
    0: {3: 240 + 480 * 600, 5: 100 + 480 * 700},
    5: {3: 241 + 480 * 601},
    15: {},
}


def write_wildtrack(folder: Path) -> Rig:
    """Write seven cameras, frames 0, 5 and 15, and images of two frames of C1."""
    rig = rig_around(3.0, 6.0, 7)
    for kind, lens in (("intrinsic_zero", [0] * 5), ("intrinsic_original", LENS)):
        target = folder / "calibrations" / kind
        target.mkdir(parents=True)
        for label in WILDTRACK_CAMERAS:
            (target / f"intr_{label}.xml").write_text(
                xml(camera_matrix=data(INTRINSICS), distortion_coefficients=data(lens))
            )
    (folder / "calibrations" / "extrinsic").mkdir()
    for camera, label in enumerate(WILDTRACK_CAMERAS):
        vector = Rotation.from_matrix(rig.R[camera]).as_rotvec()
        (folder / "calibrations" / "extrinsic" / f"extr_{label}.xml").write_text(
            xml(
                rvec="\n " + " ".join(map(repr, vector.tolist())) + "\n",
                tvec="\n " + " ".join(map(repr, (100 * np.asarray(rig.t[camera])).tolist())),
            )
        )
    for frame, people in WILDTRACK_PEOPLE.items():
        write_annotations(
            folder / "annotations_positions" / f"{frame:08d}.json",
            people,
            lambda cell: [view(rig, c, wildtrack_position(cell)) for c in range(7)],
        )
    images = folder / "Image_subsets" / "C1"
    images.mkdir(parents=True)
    for frame in (0, 5):
        (images / f"{frame:08d}.png").touch()
    return rig


def mirrored(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Write extrinsics as MultiviewX publishes them: y is 16 - y and depth is negative."""
    flip = np.diag([1.0, -1, 1])
    R, t = np.asarray(rig.R), np.asarray(rig.t)
    return -R @ flip, -(t + R @ np.array([0, 16.0, 0]))


MULTIVIEWX_PEOPLE = {
    1: {0: 500 + 1000 * 320, 1: 400 + 1000 * 200},
    2: {0: 501 + 1000 * 320},
}


def multiviewx_position(cell: int) -> np.ndarray:
    return np.array([0.025 * (cell % 1000), 16 - 0.025 * (cell // 1000)])


def write_multiviewx(folder: Path, *, images: tuple[int, ...] = (0, 1)) -> Rig:
    rig = rig_around(12.5, 8.0, 6)
    R, t = mirrored(rig)
    for kind in ("intrinsic", "extrinsic"):
        (folder / "calibrations" / kind).mkdir(parents=True)
    for camera in range(6):
        (folder / "calibrations" / "intrinsic" / f"intr_Camera{camera + 1}.xml").write_text(
            xml(camera_matrix=data(INTRINSICS), distortion_coefficients=data([1e-6] * 5))
        )
        vector = Rotation.from_matrix(R[camera]).as_rotvec()
        (folder / "calibrations" / "extrinsic" / f"extr_Camera{camera + 1}.xml").write_text(
            xml(rvec=data(vector), tvec=data(t[camera]))
        )
        for image in images:
            target = folder / "Image_subsets" / f"C{camera + 1}" / f"{image:04d}.jpg"
            target.parent.mkdir(parents=True, exist_ok=True)
            target.touch()
    for number, people in MULTIVIEWX_PEOPLE.items():
        write_annotations(
            folder / "annotations_positions" / f"{number:05d}.json",
            people,
            lambda cell: [view(rig, c, multiviewx_position(cell)) for c in range(6)],
        )
    return rig


def assert_feet_at_box_bottoms(sequence: MultiViewSequence) -> None:
    """The true position projects to the bottom of the annotated box, in its middle."""
    assert sequence.rig is not None
    assert sequence.identity is not None
    truth = {tuple(row[:2]): row[2:] for row in sequence.ground_truth.tolist()}
    boxes = sequence.detections
    for frame, camera, box, person in zip(
        boxes.frame, boxes.camera, boxes.box, sequence.identity, strict=True
    ):
        x, y = truth[frame, person]
        seen = sequence.rig.R[camera] @ [x, y, 0] + sequence.rig.t[camera]
        u, v = (sequence.rig.K[camera] @ seen)[:2] / seen[2]
        assert seen[2] > 0
        assert box[0] < u < box[2]
        assert box[3] - 0.15 * (box[3] - box[1]) < v <= box[3] + 1


def test_wildtrack(tmp_path):
    written = write_wildtrack(tmp_path)
    sequence = read_wildtrack(tmp_path)
    assert sequence.rig is not None
    for name in ("K", "R", "t"):
        np.testing.assert_allclose(getattr(sequence.rig, name), getattr(written, name), atol=1e-12)
    assert sequence.rig.distortion is None
    assert sequence.scene is not None
    assert sequence.scene.metric
    np.testing.assert_array_equal(sequence.frames, [0, 5, 15])
    np.testing.assert_allclose(
        sequence.ground_truth, [[0, 3, 3, 6], [0, 5, -0.5, 8.5], [5, 3, 3.025, 6.025]], atol=1e-12
    )
    assert len(sequence.detections) == 21
    assert_feet_at_box_bottoms(sequence)
    first = tmp_path / "Image_subsets" / "C1"
    assert sequence.images[0] == (first / "00000000.png", first / "00000005.png", None)
    assert sequence.images[6] == (None, None, None)
    assert sequence.evaluation_area == (-3, 9, -9, 27)
    part = sequence.select_frames([5])
    assert part.images[0] == (first / "00000005.png",)
    assert part.identity is not None
    np.testing.assert_array_equal(part.identity, [3] * 7)


def test_wildtrack_with_lenses(tmp_path):
    write_wildtrack(tmp_path)
    rig = read_wildtrack(tmp_path, undistorted=False).rig
    assert rig is not None
    np.testing.assert_array_equal(rig.distortion, [LENS] * 7)


def test_multiviewx(tmp_path):
    written = write_multiviewx(tmp_path)
    sequence = read_multiviewx(tmp_path)
    assert sequence.rig is not None
    for name in ("K", "R", "t"):
        np.testing.assert_allclose(getattr(sequence.rig, name), getattr(written, name), atol=1e-12)
    np.testing.assert_array_equal(sequence.frames, [0, 1])  # file 00001.json is image 0000
    np.testing.assert_allclose(
        sequence.ground_truth, [[0, 0, 12.5, 8], [0, 1, 10, 11], [1, 0, 12.525, 8]], atol=1e-12
    )
    assert_feet_at_box_bottoms(sequence)
    assert sequence.images[5][1] == tmp_path / "Image_subsets" / "C6" / "0001.jpg"


@pytest.mark.parametrize(
    ("images", "first", "frames"),
    [((), None, [0, 1]), ((1, 2), None, [1, 2]), ((0, 1, 2), None, [0, 1]), ((), 0, [1, 2])],
)
def test_multiviewx_annotation_numbers(images, first, frames, tmp_path):
    write_multiviewx(tmp_path, images=images)
    sequence = read_multiviewx(tmp_path, first_annotation=first)
    np.testing.assert_array_equal(sequence.frames, frames)
    assert bool(sequence.images) == bool(images)


def write_matchings(folder: Path, rig: Rig) -> None:
    """Write two people as cuboids, seen by all cameras, with the renderer's negative numbers."""
    (folder / "matchings").mkdir()
    feet = {(1, -40): (12.5, 8.0), (1, -50): (10.0, 7.0), (2, -40): (12.25, 8.0)}  # left-handed
    for camera in range(6):
        flat, solid = [], []
        for (frame, person), (x, y) in feet.items():
            corners = [
                (x + i * RADIUS, y + j * RADIUS, z)
                for z in (0.0, HEIGHT)
                for i, j in ((1, 1), (-1, 1), (1, -1), (-1, -1))
            ]
            points = np.array([*corners, (x, y, 0.0)])
            seen = (points * [1, -1, 1] + [0, 16, 0]) @ rig.R[camera].T + rig.t[camera]
            pixel = (seen @ rig.K[camera].T)[:, :2] / seen[:, 2:]
            flat.append(" ".join(map(str, [frame, person, *pixel.ravel()])))
            solid.append(" ".join(map(str, [frame, person, *points.ravel()])))
        (folder / "matchings" / f"Camera{camera + 1}.txt").write_text("\n".join(flat) + "\n")
        (folder / "matchings" / f"Camera{camera + 1}_3d.txt").write_text("\n".join(solid) + "\n")


def test_multiviewx_matchings(tmp_path):
    rig = write_multiviewx(tmp_path)
    write_matchings(tmp_path, rig)
    sequence = read_multiviewx(tmp_path, boxes="matchings")
    np.testing.assert_allclose(
        sequence.ground_truth, [[0, 0, 10, 9], [0, 1, 12.5, 8], [1, 1, 12.25, 8]]
    )
    assert len(sequence.detections) == 18
    assert_feet_at_box_bottoms(sequence)
    annotated = read_multiviewx(tmp_path)
    assert len(annotated.ground_truth) == 3
    for file in (tmp_path / "annotations_positions").iterdir():
        file.unlink()
    assert len(read_multiviewx(tmp_path).detections) == 18  # the only source left
    (tmp_path / "matchings" / "Camera2.txt").write_text("1 -40 3 4\n")
    with pytest.raises(FileFormatError, match=r"Camera2\.txt .*line 1 has 4 columns instead of 20"):
        read_multiviewx(tmp_path)


@pytest.mark.parametrize("read", [read_wildtrack, read_multiviewx])
class TestAnnotationErrors:
    @staticmethod
    def damaged(read, folder: Path, change) -> Path:
        """Change the first annotation file of the folder."""
        (write_wildtrack if read is read_wildtrack else write_multiviewx)(folder)
        path = min((folder / "annotations_positions").iterdir())
        people = json.loads(path.read_text())
        change(people)
        path.write_text(json.dumps(people))
        return path

    @pytest.mark.parametrize(
        ("key", "value", "message"),
        [
            ("xmax", -500, "the box of person 1 of frame 0 in camera C2 .* no area"),
            ("xmin", float("nan"), "the box of person 1 of frame 0 in camera C2 .* no area"),
            ("ymin", "high", "the box of person 1 of frame 0 in camera C2"),
            ("viewNum", 7, "person 1 of frame 0 has viewNum 7, but there are [67] cameras"),
        ],
    )
    def test_views(self, read, key, value, message, tmp_path):
        path = self.damaged(
            read, tmp_path, lambda people: people[1]["views"][1].update({key: value})
        )
        with pytest.raises(CatFreeError, match=f"{path.name}: {message}"):
            read(tmp_path)

    def test_invalid_boxes_may_be_dropped(self, read, tmp_path):
        (tmp_path / "whole").mkdir()
        (tmp_path / "less").mkdir()
        self.damaged(read, tmp_path / "whole", lambda people: None)
        self.damaged(
            read, tmp_path / "less", lambda people: people[1]["views"][1].update({"xmax": -500})
        )
        whole, less = read(tmp_path / "whole"), read(tmp_path / "less", invalid_boxes="drop")
        assert len(less.detections) == len(whole.detections) - 1
        assert len(less.ground_truth) == len(whole.ground_truth)

    def test_unseen_people(self, read, tmp_path):
        def hide(people):
            for seen in people[0]["views"]:
                seen.update(xmin=-1, ymin=-1, xmax=-1, ymax=-1)

        self.damaged(read, tmp_path, hide)
        assert len(read(tmp_path).ground_truth) == 3
        assert len(read(tmp_path, drop_unseen=True).ground_truth) == 2

    @pytest.mark.parametrize("cell", [-1, 691200])
    def test_cells_off_the_grid(self, read, cell, tmp_path):
        path = self.damaged(read, tmp_path, lambda people: people[1].update(positionID=cell))
        with pytest.raises(InvalidInputError, match=f"{path.name}: person 1 .* positionID {cell}"):
            read(tmp_path)

    def test_truncated_annotations(self, read, tmp_path):
        path = self.damaged(read, tmp_path, lambda people: None)
        path.write_text(path.read_text()[:300])
        with pytest.raises(FileFormatError, match=f"{path.name} .* not valid JSON"):
            read(tmp_path)

    def test_calibration_files(self, read, tmp_path):
        self.damaged(read, tmp_path, lambda people: None)
        path = max((tmp_path / "calibrations" / "extrinsic").iterdir())
        text = path.read_text()
        path.write_text(text.replace("tvec", "offset"))
        with pytest.raises(FileFormatError, match=f"{path.name} .* has no 'tvec'"):
            read(tmp_path)
        path.write_text(text[:-20])
        with pytest.raises(FileFormatError, match=f"{path.name} .* malformed"):
            read(tmp_path)
        path.unlink()
        with pytest.raises(InvalidInputError, match=f"no file .*{path.name}"):
            read(tmp_path)


def test_mirrored_wildtrack_is_refused(tmp_path):
    rig = write_wildtrack(tmp_path)
    for camera, label in enumerate(WILDTRACK_CAMERAS):
        turned = np.diag([-1.0, 1, -1]) @ rig.R[camera]  # looks the other way
        shift = np.diag([-1.0, 1, -1]) @ rig.t[camera]
        vector = Rotation.from_matrix(turned).as_rotvec()
        (tmp_path / "calibrations" / "extrinsic" / f"extr_{label}.xml").write_text(
            xml(rvec=" ".join(map(str, vector)), tvec=" ".join(map(str, 100 * shift)))
        )
    with pytest.raises(InvalidInputError, match="behind every camera"):
        read_wildtrack(tmp_path)


def test_corrected_multiviewx_is_refused(tmp_path):
    rig = write_multiviewx(tmp_path)
    path = tmp_path / "calibrations" / "extrinsic" / "extr_Camera3.xml"
    vector = Rotation.from_matrix(rig.R[2]).as_rotvec()
    path.write_text(xml(rvec=data(vector), tvec=data(rig.t[2])))
    with pytest.raises(InvalidInputError, match=r"extr_Camera3\.xml: camera C3 .* positive depth"):
        read_multiviewx(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read", "original", "uniform"),
    [
        (read_wildtrack, "wildtrack_original", "wildtrack_0_715"),
        (read_multiviewx, "multiviewx_demo10_original", "multiviewx_demo10"),
    ],
)
def test_published_calibration(read, original, uniform, shared):
    sequence = read(shared / "data" / "real" / original)
    reference = read_uniform_json(shared / "data" / "real" / f"{uniform}.json")
    assert sequence.rig is not None
    assert reference.rig is not None
    for name in ("K", "R", "t", "image_size"):
        np.testing.assert_allclose(
            getattr(sequence.rig, name), getattr(reference.rig, name), rtol=0, atol=1e-12
        )
    assert sequence.camera_names == reference.camera_names
