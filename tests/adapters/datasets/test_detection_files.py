"""Boxes of all cameras: every format gives the same detections, and errors name mistakes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf
from catfree.adapters import (
    read_coco,
    write_detections_parquet,
    write_mot_boxes,
    write_scene_json,
)
from catfree.adapters.datasets._detection_files import (
    holds_boxes,
    read_camera_boxes,
    read_missing_pictures,
    write_missing_pictures,
)
from catfree.errors import FileFormatError, InvalidInputError
from catfree.synthetic import make_world

NAMES = ("C1", "C2", "C10")


@pytest.fixture
def boxes():
    return cf.Detections(
        [1, 1, 1, 2, 3, 3],
        [0, 1, 2, 0, 1, 1],
        [[1, 2, 11, 32], [5, 5, 20, 60], [0, 0, 9, 9], [3, 4, 5, 6], [1, 1, 2, 3], [7, 7, 9, 20]],
        score=[0.5, 0.25, 1.0, 0.75, 0.5, 0.125],
    )


def rows_of(detections):
    score = np.ones(len(detections)) if detections.score is None else detections.score
    table = np.column_stack([detections.frame, detections.camera, detections.box, score])
    return table[np.lexsort(table.T[::-1])]


def write_mot(folder, boxes):
    folder.mkdir()
    for camera, name in enumerate(NAMES):
        write_mot_boxes(folder / f"{name}.txt", boxes[boxes.camera == camera], [1, 2, 3])
    return folder


def write_mot_folders(folder, boxes):
    for camera, name in enumerate(NAMES):
        (folder / name / "det").mkdir(parents=True)
        path = folder / name / "det" / "det.txt"
        write_mot_boxes(path, boxes[boxes.camera == camera], [1, 2, 3])
    return folder


def columns_of(boxes, names=None):
    camera = boxes.camera if names is None else np.array(names)[boxes.camera]
    corners = dict(zip(("x1", "y1", "x2", "y2"), boxes.box.T, strict=True))
    return {"frame": boxes.frame, "camera": camera, **corners, "score": boxes.score}


def write_csv(path, columns):
    lines = [",".join(columns)]
    lines += [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(lines) + "\n")
    return path


def coco_rows(boxes, image_id):
    corner, size = boxes.box[:, :2], boxes.box[:, 2:] - boxes.box[:, :2]
    return [
        {
            "image_id": image_id(int(boxes.frame[n]), int(boxes.camera[n])),
            "category_id": 1,
            "bbox": [*corner[n].tolist(), *size[n].tolist()],
            "score": float(boxes.score[n]),
        }
        for n in range(len(boxes))
    ]


def write_uniform(path, boxes):
    frames = []
    for frame in (1, 2, 3):
        views = {}
        for camera, name in enumerate(NAMES):
            here = boxes[(boxes.frame == frame) & (boxes.camera == camera)]
            views[name] = [
                {"box": box.tolist(), "score": float(score)}
                for box, score in zip(here.box, here.score, strict=True)
            ]
        frames.append({"frame": frame, "views": views})
    cameras = [{"name": name} for name in NAMES]
    path.write_text(json.dumps({"units": "m", "cameras": cameras, "frames": frames}))
    return path


def test_every_format_gives_the_same_boxes(boxes, tmp_path):
    pytest.importorskip("pyarrow")
    sources = {
        "folder of MOT": write_mot(tmp_path / "mot", boxes),
        "folders of MOT": write_mot_folders(tmp_path / "sequences", boxes),
        "uniform JSON": write_uniform(tmp_path / "uniform.json", boxes),
        "CSV": write_csv(tmp_path / "boxes.csv", columns_of(boxes)),
        "CSV with names": write_csv(tmp_path / "named.csv", columns_of(boxes, NAMES)),
        "CSV with semicolons": tmp_path / "semicolons.csv",
        "Parquet": write_detections_parquet(tmp_path / "boxes.parquet", boxes),
    }
    sources["CSV with semicolons"].write_text(sources["CSV"].read_text().replace(",", ";"))
    boxes.save(tmp_path / "boxes.npz")
    sources["npz"] = tmp_path / "boxes.npz"
    results = []
    for camera, name in enumerate(NAMES):
        results.append(tmp_path / f"{name}.json")
        rows = coco_rows(boxes[boxes.camera == camera], lambda frame, _: frame)
        results[-1].write_text(json.dumps(rows))
    for path in (*sources.values(), results):
        found, names = cf.read_detections(path)
        np.testing.assert_array_equal(rows_of(found), rows_of(boxes), str(path))
        assert names in (NAMES, ("C1", "C2", "C3"))


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.integers(-5, 99), st.integers(0, 2)), max_size=8),
    st.sampled_from(["csv", "parquet"]),
    st.booleans(),
)
def test_missing_pictures_name_or_number_their_cameras(tmp_path_factory, rows, suffix, named):
    table = {
        "frame": [frame for frame, _ in rows],
        "camera": [NAMES[camera] if named else camera for _, camera in rows],
    }
    path = tmp_path_factory.mktemp("missing") / f"missing.{suffix}"
    if suffix == "csv":
        write_csv(path, table)
    else:
        arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
        parquet.write_table(arrow.table(table), path)
    found = cf.adapters.read_missing_pictures(path, NAMES)
    np.testing.assert_array_equal(found, np.array(rows, np.int64).reshape(-1, 2))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("frame,camera\n3,C7\n", "line 2: there is no camera 'C7' among C1, C2, C10"),
        ("frame,camera\n3,C1\n\n4,3\n", "line 4: there is no camera '3'"),
        ("frame,camera\n\n3.5,C1\n", "frame in line 3 is 3.5"),
        ("frame,camera\nx,C1\n", "frame in line 2 is 'x', not a number"),
        ("frame\n3\n", "no columns frame and camera"),
        ("3,1\n", "no columns frame and camera"),
        ("", "no columns frame and camera"),
    ],
)
def test_a_damaged_table_of_missing_pictures_is_named(text, sentence, tmp_path):
    (tmp_path / "missing.csv").write_text(text)
    with pytest.raises((FileFormatError, InvalidInputError), match=sentence) as error:
        cf.adapters.read_missing_pictures(tmp_path / "missing.csv", NAMES)
    assert "missing.csv" in str(error.value)


@pytest.mark.parametrize(
    ("kind", "twice"),
    [("dictionary", False), ("timestamp", False), ("struct", False), ("int64", True)],
)
def test_a_column_of_missing_pictures_that_holds_no_numbers_is_refused(kind, twice, tmp_path):
    arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    kinds = {
        "dictionary": arrow.dictionary("int8", "string"),
        "timestamp": arrow.timestamp("ns"),
        "struct": arrow.struct([("a", arrow.int8())]),
        "int64": arrow.int64(),
    }
    for name in ("frame", "camera"):
        table = arrow.table({"frame": [0, 1], "camera": [0, 1]})
        at = table.schema.get_field_index(name)
        column = arrow.nulls(2, kinds[kind])
        table = table.append_column(name, column) if twice else table.set_column(at, name, column)
        parquet.write_table(table, tmp_path / "missing.parquet")
        with pytest.raises((FileFormatError, InvalidInputError), match=r"missing\.parquet"):
            cf.adapters.read_missing_pictures(tmp_path / "missing.parquet", NAMES)


def test_tables_of_other_programs(boxes, tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    table = pandas.DataFrame(columns_of(boxes, NAMES))
    table["left"], table["top"] = table.x1, table.y1
    table["width"], table["height"] = table.x2 - table.x1, table.y2 - table.y1
    table = table.drop(columns=["x1", "y1", "x2", "y2"]).rename(
        columns={"frame": "frame_id", "score": "confidence"}
    )
    table.to_parquet(tmp_path / "table.parquet")
    found, names = cf.read_detections(tmp_path / "table.parquet")
    assert names == NAMES
    np.testing.assert_array_equal(rows_of(found), rows_of(boxes))


def test_files_of_a_folder_may_end_in_capitals_beside_what_systems_leave(boxes, tmp_path):
    folder = write_mot(tmp_path / "mot", boxes)
    for path in folder.iterdir():
        path.rename(path.with_suffix(".TXT"))
    nested = write_mot_folders(tmp_path / "nested", boxes)
    for place in (folder, nested, nested / "C1" / "det", nested / ".checkpoints" / "det"):
        place.mkdir(parents=True, exist_ok=True)
        for name in (".DS_Store", "Thumbs.db", "._det.txt", "._C1.TXT"):
            (place / name).write_bytes(b"\0\1")
        (place / "__MACOSX").mkdir()
    (nested / ".checkpoints" / "det" / "det.txt").write_text("1")
    for source in (folder, nested):
        found, names = cf.read_detections(source)
        np.testing.assert_array_equal(rows_of(found), rows_of(boxes))
        assert names == NAMES


def test_a_camera_without_a_name_is_refused(boxes, tmp_path):
    arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    columns = columns_of(boxes) | {"camera": ["a", "b", None, "a", "b", "b"]}
    parquet.write_table(arrow.table(columns), tmp_path / "boxes.parquet")
    with pytest.raises(FileFormatError, match=r"boxes.parquet: camera\[2\] is empty"):
        cf.read_detections(tmp_path / "boxes.parquet")


def test_a_folder_of_tables_of_boxes_holds_nothing_else(boxes, tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet")
    write_detections_parquet(tmp_path / "boxes.PARQUET", boxes)
    (tmp_path / "_SUCCESS").write_text("")
    assert len(cf.read_detections(tmp_path)[0]) == len(boxes)
    (tmp_path / "truth.csv").write_text("frame,id,x,y\n")
    with pytest.raises(InvalidInputError, match=r"other files, such as truth\.csv\. Name the file"):
        cf.read_detections(tmp_path)
    (tmp_path / "tracks").mkdir()
    write_detections_parquet(tmp_path / "tracks" / "a.parquet", boxes)
    table = pyarrow.parquet.read_table(tmp_path / "tracks" / "a.parquet")
    pyarrow.parquet.write_table(table.drop("camera"), tmp_path / "tracks" / "a.parquet")
    with pytest.raises(FileFormatError, match=r"^[^ ]+ has no column 'camera'; a table of"):
        cf.read_detections(tmp_path / "tracks")


def test_a_table_of_named_cameras_keeps_its_embeddings(boxes, tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    looks = np.random.default_rng(0).normal(size=(len(boxes), 4))
    table = pandas.DataFrame(columns_of(boxes, NAMES) | {"embedding": list(looks)})
    table.to_parquet(tmp_path / "table.parquet")
    found, names = cf.read_detections(tmp_path / "table.parquet")
    assert names == NAMES
    np.testing.assert_array_equal(found.embedding, looks)
    table.at[0, "embedding"] = looks[0, :2]
    table.to_parquet(tmp_path / "table.parquet")
    with pytest.raises(FileFormatError, match="different lengths"):
        cf.read_detections(tmp_path / "table.parquet")


def test_numbers_of_cameras_may_be_written_as_floats(boxes, tmp_path):
    columns = columns_of(boxes) | {"camera": boxes.camera.astype(float)}
    read, names = cf.read_detections(write_csv(tmp_path / "boxes.csv", columns))
    assert names == ("C1", "C2", "C3")
    np.testing.assert_array_equal(rows_of(read), rows_of(boxes))
    columns["camera"] = np.array([1.5, 2.5, 3.5])[boxes.camera]  # names, such as floor and number
    _, names = cf.read_detections(write_csv(tmp_path / "boxes.csv", columns))
    assert names == ("1.5", "2.5", "3.5")
    columns["camera"] = np.array(["7", "007", "1e1"])[boxes.camera]  # 007 is not camera 7
    _, names = cf.read_detections(write_csv(tmp_path / "boxes.csv", columns))
    assert set(names) == {"7", "007", "1e1"}


@given(
    st.lists(st.integers(0, 12).map(str), min_size=3, max_size=5, unique=True),
    st.lists(st.integers(0, 2), min_size=1, max_size=6),
    st.sampled_from(["csv", "words.parquet", "numbers.parquet"]),
)
def test_cameras_named_by_numbers_are_read_by_name(tmp_path_factory, names, cameras, kind):
    count = len(cameras)
    boxes = cf.Detections(range(count), cameras, np.tile([1.0, 2, 3, 9], (count, 1)))
    columns = columns_of(boxes, names)
    del columns["score"]
    path = tmp_path_factory.mktemp("boxes") / f"boxes.{kind}"
    if kind == "csv":
        write_csv(path, columns)
    else:
        if kind.startswith("numbers"):
            columns["camera"] = columns["camera"].astype(int)
        arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
        parquet.write_table(arrow.table(columns), path)
    read, given_back = cf.read_detections(path, names)
    assert given_back == tuple(names)
    np.testing.assert_array_equal(read.camera, cameras)
    # Tables written by catfree have positions.
    boxes.save(path.with_suffix(".npz"))
    write_detections_parquet(path.with_suffix(".parquet"), boxes)
    for own in (path.with_suffix(".npz"), path.with_suffix(".parquet")):
        np.testing.assert_array_equal(cf.read_detections(own, names)[0].camera, cameras)


def test_numbers_that_are_not_all_names_are_positions(boxes, tmp_path):
    path = write_csv(tmp_path / "boxes.csv", columns_of(boxes))
    for names in (("1", "2", "3", "4"), ("C2", "C1", "C3")):
        read = read_camera_boxes(path, names)
        assert read.camera_names == names
        np.testing.assert_array_equal(read.detections.camera, boxes.camera)
    missing = write_csv(tmp_path / "missing.csv", {"frame": [3, 4, 5], "camera": [1, 2, 3]})
    read_missing = cf.adapters.read_missing_pictures
    assert read_missing(missing, list("1234"))[:, 1].tolist() == [0, 1, 2]
    assert read_missing(missing, list("2345"))[:, 1].tolist() == [1, 2, 3]
    mixed = write_csv(tmp_path / "mixed.csv", {"frame": [3, 4, 5], "camera": ["a", 1, 2]})
    assert read_missing(mixed, ["a", "b", "1"])[:, 1].tolist() == [0, 2, 2]


def test_numbers_without_0_name_cameras_that_have_no_other_names(boxes, tmp_path):
    arrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    columns = columns_of(boxes, ["2", "7", "31"])
    path = write_csv(tmp_path / "boxes.csv", columns)
    parquet.write_table(arrow.table(columns), tmp_path / "boxes.parquet")
    for source in (path, tmp_path / "boxes.parquet"):
        found = read_camera_boxes(source, ("north", "east", "south"))
        assert found.camera_names == ("2", "7", "31")
        np.testing.assert_array_equal(rows_of(found.detections), rows_of(boxes))
    later = boxes[boxes.camera > 0]
    write_detections_parquet(tmp_path / "boxes.parquet", later)  # these are positions
    assert read_camera_boxes(tmp_path / "boxes.parquet").camera_names == ("C1", "C2", "C3")


def test_a_number_of_a_camera_beyond_all_rigs_is_refused(boxes, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(f"frame,camera,x1,y1,x2,y2\n0,{10**12},1,2,3,9\n")
    with pytest.raises(InvalidInputError, match=r"table.csv: camera in line 2 is 1000000000000"):
        cf.read_detections(path)


@pytest.mark.parametrize("suffix", ["json", "JSON"])
def test_a_data_set_of_coco_tells_the_images_of_results(suffix, boxes, tmp_path):
    images = [
        {"id": 100 * camera + frame, "file_name": f"{name}/{frame:05d}.png"}
        | {"width": 640, "height": 480}
        for camera, name in enumerate(NAMES)
        for frame in (1, 2, 3)
    ]
    categories = [{"id": 7, "name": "dog"}, {"id": 1, "name": "person"}]
    described = tmp_path / f"instances.{suffix}"
    described.write_text(json.dumps({"images": images, "categories": categories}))
    results = tmp_path / f"results.{suffix}"
    rows = coco_rows(boxes, lambda frame, camera: 100 * camera + frame)
    results.write_text(json.dumps([*rows, rows[0] | {"category_id": 7}]))
    found = read_camera_boxes([results, described])
    assert found.camera_names == NAMES
    np.testing.assert_array_equal(found.image_size, [[640, 480]] * 3)
    np.testing.assert_array_equal(rows_of(found.detections), rows_of(boxes))
    results.write_text(json.dumps([rows[0] | {"image_id": 9999}]))
    with pytest.raises(FileFormatError, match=r"box 0 is of the image 9999, which is not listed"):
        read_coco(results, described)
    results.write_text(json.dumps([rows[0] | {"bbox": [1, 2, 0, 4]}]))
    with pytest.raises(InvalidInputError, match="no area"):
        read_coco(results, described)


def test_results_without_people_name_their_categories(tmp_path):
    shown = {"image_id": 1, "bbox": [1, 2, 9, 60]}
    results, described = tmp_path / "results.json", tmp_path / "instances.json"
    results.write_text(json.dumps([shown | {"category_id": other} for other in (10, 0, 2)]))
    with pytest.raises(FileFormatError, match="category_id is 1; the boxes have 0, 2, 10"):
        cf.read_detections(results)
    categories = [{"id": 0, "name": "person"}]
    images = [{"id": 1, "file_name": "C1/1.png"}]
    described.write_text(json.dumps({"images": images, "categories": categories}))
    assert len(cf.read_detections([results, described])[0]) == 1
    results.write_text("[]")
    assert len(cf.read_detections(results)[0]) == 0


def test_a_folder_of_tables_may_name_its_cameras(boxes, tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    for name, part in (("a", boxes[:3]), ("b", boxes[3:])):
        table = pyarrow.table(columns_of(part, NAMES))
        parquet.write_table(table, tmp_path / f"{name}.parquet")
    found, names = cf.read_detections(tmp_path)
    assert names == NAMES
    np.testing.assert_array_equal(rows_of(found), rows_of(boxes))
    content = bytearray((tmp_path / "b.parquet").read_bytes())
    content[20:200] = bytes(180)
    (tmp_path / "b.parquet").write_bytes(content)
    with pytest.raises(FileFormatError, match="is not readable Parquet"):
        cf.read_detections(tmp_path)


def test_images_of_one_camera_have_one_size(tmp_path):
    images = [
        {"id": at, "file_name": f"{camera}/{at}.png", "width": 100 * size, "height": 50 * size}
        for at, (camera, size) in enumerate([("a", 1), ("b", 2), ("a", 1), ("b", 2)])
    ]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"images": images, "annotations": []}))
    np.testing.assert_array_equal(read_coco(path).image_size, [[100, 50], [200, 100]])
    # An image may leave its size to the others of its camera, in any order.
    unsized = [{key: image[key] for key in ("id", "file_name")} for image in images]
    for listed in ([*images[:2], *unsized[2:]], [*unsized[:2], *images[2:]]):
        path.write_text(json.dumps({"images": listed, "annotations": []}))
        np.testing.assert_array_equal(read_coco(path).image_size, [[100, 50], [200, 100]])
    images[2] |= {"width": 200}
    path.write_text(json.dumps({"images": images, "annotations": []}))
    with pytest.raises(FileFormatError, match=r"image 2 .*'a/2\.png'.* is 200 x 50 px.*100 x 50"):
        read_coco(path)


def test_images_of_coco_with_one_id_are_refused_and_groups_left_out(tmp_path):
    images = [{"id": 1, "file_name": "a/1.png"}, {"id": 1, "file_name": "b/1.png"}]
    box = {"image_id": 1, "bbox": [1, 2, 3, 4]}
    boxes = [box | {"iscrowd": 0}, box | {"iscrowd": 1}]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"images": images, "annotations": boxes}))
    with pytest.raises(FileFormatError, match=r"a\.json: .*'a/1\.png' and 'b/1\.png'.* same id, 1"):
        read_coco(path)
    path.write_text(json.dumps({"images": [images[0], images[0]], "annotations": boxes}))
    assert len(read_coco(path).detections) == 1


@pytest.mark.parametrize("described", [False, True])
def test_two_images_of_coco_are_not_taken_for_one(described, tmp_path):
    names = ["a/cam1_0005.jpg", "a/cam2_0005.jpg"]
    box = {"category_id": 1, "bbox": [1, 2, 3, 4]}
    document = [box | {"image_id": name} for name in names]
    if described:
        images = [{"id": name, "file_name": name} for name in names]
        document = {"images": images, "annotations": document}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match=r"a\.json: .*cam1_0005.* and .*cam2_0005.* frame 5"):
        read_coco(path)
    path.write_text(path.read_text().replace("a/cam2", "b/cam2"))
    assert read_coco(path).camera_names == ("a", "b")


@pytest.mark.slow
@given(order=st.permutations(range(3)), ending=st.sampled_from(["", ".png", "/000000.jpg"]))
def test_files_find_their_cameras_by_name(order, ending, tmp_path_factory):
    boxes = cf.Detections([1, 1, 1], [0, 1, 2], [[0, 0, 1, 1], [0, 0, 2, 2], [0, 0, 3, 3]])
    folder = write_mot(tmp_path_factory.mktemp("boxes") / "mot", boxes)
    wanted = [NAMES[at] + ending for at in order]
    found, names = cf.read_detections(folder, wanted)
    assert names == tuple(wanted)
    width = {camera: 1 + place for camera, place in enumerate(order)}
    assert [width[camera] for camera in found.camera.tolist()] == found.box[:, 2].tolist()


def test_cameras_may_be_missing_but_not_unknown(boxes, tmp_path):
    folder = write_mot(tmp_path / "mot", boxes)
    found, _ = cf.read_detections(folder, ["C0", "C1", "C2", "C10", "C11"])
    assert set(found.camera.tolist()) == {1, 2, 3}
    with pytest.raises(InvalidInputError, match="C1, C2, C10, which are not all among C1, north"):
        cf.read_detections(folder, ["C1", "north", "C10"])


def test_frames_get_a_clock(boxes, tmp_path):
    folder = write_mot(tmp_path / "mot", boxes)
    found, _ = cf.read_detections(folder, frame_rate=25)
    assert found.clock == cf.Clock(25)


def test_a_rate_changes_nothing_else_of_a_clock(boxes, tmp_path):
    clock = cf.Clock(5.0, 1.764e9, utc=True)
    cf.Detections(**(vars(boxes) | {"clock": clock})).save(tmp_path / "boxes.npz")
    assert cf.adapters.read_detections(tmp_path / "boxes.npz")[0].clock == clock
    detections, _ = cf.adapters.read_detections(tmp_path / "boxes.npz", frame_rate=10)
    assert detections.clock == cf.Clock(10.0, 1.764e9, utc=True)


@pytest.mark.parametrize("step", [1, 5])
def test_uniform_json_has_the_clock_of_its_instants(boxes, step, tmp_path):
    path = write_uniform(tmp_path / "uniform.json", boxes)
    document = json.loads(path.read_text())
    assert cf.adapters.read_detections(path)[0].clock is None
    for record in document["frames"]:
        record["frame"] *= step
    path.write_text(json.dumps(document | {"fps": 2}))
    assert cf.adapters.read_detections(path)[0].clock == cf.Clock(2.0 * step)


def test_no_boxes_at_all_are_no_error(tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.txt").write_text("")
    found, names = cf.read_detections(tmp_path)
    assert len(found) == 0
    assert names == ("a", "b")


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.csv", "frame,camera,left\n1,2,3\n", "has the columns frame, camera, left"),
        (
            "a.csv",
            "frame,camera,x1,y1,x2,y2\n\n,,,,,\n1,2,3\n",
            "line 4 has 3 columns instead of 6",
        ),
        ("a.csv", "frame,camera,x1,y1,x2,y2\n1,0,3,4,5,no\n", "y2 in line 2 is 'no', not a number"),
        ("a.csv", f"frame,camera,x1,y1,x2,y2\n1,{'9' * 20},3,4,5,6\n", r"a\.csv: camera.*63 bits"),
        (
            "a.csv",
            "frame,camera,x1,y1,x2,y2\n1,0,3,4,5,6\n\n1,0,5,4,3,6\n",
            "box in line 4 is .*xyxy",
        ),
        ("a.csv", "frame,camera,x1,y1,x2,y2\n1,-1,3,4,5,6\n", r"a\.csv: camera in line 2 is -1"),
        ("a.csv", "frame,camera,x1,y1,x2,y2\n1,,3,4,5,6\n", "camera in line 2 is empty"),
        ("a.json", "[3]", "a.json"),
        ("a.json", '[{"bbox": [1, 2, 3, 4]}]', "box 0 has no 'image_id'"),
        ("a.json", '{"cameras": []}', "has no 'units'"),
        ("a.mp4", "", "not a known file of boxes"),
        ("a.txt", "1,2,3", "has 3 columns instead of 6"),
        ("a.txt", "1;1;2;3;9;9;1", "has 1 columns instead of 6. Separate columns by commas"),
        ("a.txt", "1,1,2,3,9,9,1\n\n1,1,2,3,9,0,1\n", "box in line 3 is .* y1 < y2"),
        ("a.txt", "1,1,2,3,9,9,1\n\n1,1,2,3,9,9,7\n", r"score in line 3 is 7\.0"),
        ("a.csv", "frame,camera,x1,y1,x2,y2,score\n\n1,0,3,4,5,6,7\n", r"score in line 3 is 7\.0"),
    ],
)
def test_damaged_files_are_named(name, text, sentence, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises((FileFormatError, InvalidInputError), match=sentence):
        cf.read_detections(tmp_path / name)


@pytest.mark.parametrize("header", ["frame,x1,x1,y1,x2,y2", "frame,x1,Frame,y1,x2,y2"])
def test_a_column_that_occurs_twice_is_refused(header, tmp_path):
    path = tmp_path / "boxes.csv"
    path.write_text(f"{header},note,note\n1,2,2,3,4,5,a,b\n")
    with pytest.raises(FileFormatError, match="has two columns"):
        cf.read_detections(path)
    path.write_text("frame,x1,y1,x2,y2,note,note\n1,2,3,4,5,a,b\n")
    assert cf.read_detections(path)[0].box.tolist() == [[2, 3, 4, 5]]


def test_long_numbers_of_frames_are_read_exactly(tmp_path):
    frames = [1700000000000000001, 1700000000000000003]
    rows = "".join(f"{frame},a,1,2,3,4\n" for frame in frames)
    (tmp_path / "boxes.csv").write_text(f"frame,camera,x1,y1,x2,y2\n{rows}")
    assert cf.read_detections(tmp_path / "boxes.csv")[0].frame.tolist() == frames
    pandas = pytest.importorskip("pandas")
    table = pandas.read_csv(tmp_path / "boxes.csv")
    table.to_parquet(tmp_path / "boxes.parquet")
    assert cf.read_detections(tmp_path / "boxes.parquet")[0].frame.tolist() == frames
    missing = cf.adapters.read_missing_pictures(tmp_path / "boxes.csv", ["a"])
    assert missing[:, 0].tolist() == frames


def test_missing_mixed_and_repeated_files_are_refused(boxes, tmp_path):
    folder = write_mot(tmp_path / "mot", boxes)
    table = write_csv(tmp_path / "boxes.csv", columns_of(boxes))
    (tmp_path / "empty").mkdir()
    for paths, sentence in [
        (tmp_path / "nothing", "There is no file or folder"),
        (tmp_path / "empty", "holds no boxes"),
        ([], "list of files with boxes is empty"),
        ([folder / "C1.txt", table], "boxes of one camera, but .*boxes.csv of several"),
        ([folder / "C1.txt", folder / "C1.txt"], "are the same file"),
        ([folder, table], "mot is a folder, given together with other paths"),
    ]:
        with pytest.raises(InvalidInputError, match=sentence):
            cf.read_detections(paths)


def test_tables_may_each_name_some_of_the_cameras(boxes, tmp_path):
    columns = columns_of(boxes, NAMES)
    tables = []
    for number, chosen in enumerate([boxes.camera == 1, boxes.camera != 1, boxes.camera < 0]):
        some = {name: np.asarray(column)[chosen] for name, column in columns.items()}
        tables.append(write_csv(tmp_path / f"{number}.csv", some))
    whole, _ = cf.read_detections(write_csv(tmp_path / "whole.csv", columns), NAMES)
    found, _ = cf.read_detections(tables[::-1], NAMES)
    order, expected = (np.lexsort((*one.box.T, one.camera, one.frame)) for one in (found, whole))
    for name in ("frame", "camera", "box", "score"):
        assert (getattr(found, name)[order] == getattr(whole, name)[expected]).all()
    numbered = write_csv(tmp_path / "numbered.csv", columns_of(boxes))
    with pytest.raises(InvalidInputError, match="name their cameras, and others number them"):
        cf.read_detections([tables[0], numbered])


def test_two_files_with_boxes_of_one_picture_are_refused(boxes, tmp_path):
    hours = [write_csv(tmp_path / name, columns_of(boxes)) for name in ("1.csv", "2.csv")]
    frame, camera = boxes.frame.min(), boxes.camera[boxes.frame == boxes.frame.min()].min()
    with pytest.raises(InvalidInputError, match=f"of camera {camera} in frame {frame}. Name each"):
        cf.read_detections(hours)


def test_boxes_are_told_from_videos(boxes, tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "0.PNG").write_text("")
    assert holds_boxes(write_mot(tmp_path / "mot", boxes))
    assert holds_boxes(tmp_path / "mot" / "C1.txt")
    assert not holds_boxes(tmp_path / "images")
    assert not holds_boxes(tmp_path / "a.mp4")


@pytest.mark.slow
def test_real_boxes(shared):
    found, names = cf.read_detections(
        shared / "data" / "real" / "epfl_terrace" / "terrace1_boxes.json"
    )
    assert len(names) == 4
    assert len(found) > 1000


@pytest.mark.parametrize("camera", ["9" * 5000, "cam" + "9" * 5000])
def test_numbers_of_any_length_in_names_are_read_or_refused(camera, tmp_path):
    table = tmp_path / "boxes.csv"
    table.write_text(f"frame,camera,x1,y1,x2,y2,score\n1,a,1,2,9,60,1\n1,{camera},1,2,9,60,1\n")
    assert len(cf.read_detections(table)[0]) == 2
    image = {"id": 1, "file_name": f"{camera}.jpg", "width": 64, "height": 64}
    shown = {"image_id": 1, "category_id": 1, "bbox": [1, 2, 9, 60], "score": 1}
    path = tmp_path / "coco.json"
    path.write_text(json.dumps({"images": [image], "annotations": [shown], "categories": []}))
    with pytest.raises(FileFormatError, match="has no frame number"):
        read_coco(path)


def test_boxes_of_results_keep_the_names_of_their_cameras(tmp_path):
    world = make_world("ring3", frames=3, people=2)
    world.detections.save(tmp_path / "detections.npz")
    (tmp_path / "heat_map.png").touch()
    write_scene_json(tmp_path / "scene.json", world.scene, NAMES)
    assert holds_boxes(tmp_path)
    found = read_camera_boxes(tmp_path)
    assert found.camera_names == NAMES
    np.testing.assert_array_equal(found.image_size, world.scene.rig.image_size)
    turned = cf.read_detections(tmp_path, NAMES[::-1])[0]
    np.testing.assert_array_equal(turned.camera, 2 - world.detections.camera)
    with pytest.raises(InvalidInputError, match="which are not all among A, B, C"):
        cf.read_detections(tmp_path, ["A", "B", "C"])
    scene = world.scene  # has fewer cameras than the boxes
    write_scene_json(
        tmp_path / "scene.json", replace(scene, rig=scene.rig.select([0, 1])), NAMES[:2]
    )
    assert read_camera_boxes(tmp_path, NAMES).camera_names == NAMES


@given(silent=st.lists(st.tuples(st.integers(-9, 2**62), st.integers(0, 2)), max_size=5))
def test_missing_pictures_are_read_as_they_were_written(tmp_path_factory, silent):
    names = ('a, "b"', "7", "Größe")
    pictures = np.array(silent, np.int64).reshape(-1, 2)
    path = write_missing_pictures(tmp_path_factory.mktemp("x") / "gone.csv", pictures, names)
    if len(pictures):
        np.testing.assert_array_equal(read_missing_pictures(path, names), pictures)
