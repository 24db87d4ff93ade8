"""True positions: CSV, uniform JSON, and the protocols of WildTrack and MultiviewX."""

import json

import numpy as np
import pytest

from catfree.adapters import read_ground_truth, read_multiviewx
from catfree.errors import FileFormatError, InvalidInputError
from catfree.evaluation import hota


def write_annotations(folder, frames, cameras, positions):
    """Place one person per position in every frame; no camera sees the last."""
    (folder / "annotations_positions").mkdir(parents=True)
    for frame in frames:
        people = []
        for person, cell in enumerate(positions):
            seen = person < len(positions) - 1
            box = (10, 20, 30, 90) if seen else (-1,) * 4
            corners = dict(zip(("xmin", "ymin", "xmax", "ymax"), box, strict=True))
            views = [{"viewNum": camera} | corners for camera in range(cameras)]
            people.append({"personID": person, "positionID": cell, "views": views})
        path = folder / "annotations_positions" / f"{frame:08d}.json"
        path.write_text(json.dumps(people))


def test_wildtrack_by_its_protocol(tmp_path):
    write_annotations(tmp_path, (0, 5, 1795, 1800, 1995), 7, (0, 480 * 40 + 80, 7))
    test = read_ground_truth(tmp_path)
    np.testing.assert_array_equal(test.frames, [1800, 1995])
    expected = [[1800, 0, -3, -9], [1800, 1, -1, -8], [1995, 0, -3, -9], [1995, 1, -1, -8]]
    np.testing.assert_allclose(test.rows, expected)
    assert test.area == (-3.0, 9.0, -9.0, 27.0)
    assert test.gates == (0.5, 1.0)
    assert test.protocol.startswith("WildTrack, test split (2 frames, 1800 to 1995), area x -3 to")
    assert len(read_ground_truth(tmp_path, "train").rows) == 6
    # The folder of the annotations alone suffices.
    assert len(read_ground_truth(tmp_path / "annotations_positions", "all").rows) == 10


@pytest.mark.parametrize(("cameras", "first"), [(7, 1800), (6, 360)])
def test_frames_without_people_may_come_first(cameras, first, tmp_path):
    write_annotations(tmp_path, (0, first, first + 5), cameras, (0, 1))
    for frame in (0, first):
        (tmp_path / "annotations_positions" / f"{frame:08d}.json").write_text("[]")
    truth = read_ground_truth(tmp_path)
    np.testing.assert_array_equal(truth.frames, [first, first + 5])
    np.testing.assert_array_equal(truth.rows[:, :2], [[first + 5, 0]])


def test_multiviewx_by_its_protocol(tmp_path):
    write_annotations(tmp_path, (0, 359, 360, 399), 6, (40, 0))
    test = read_ground_truth(tmp_path)
    np.testing.assert_allclose(test.rows, [[360, 0, 1, 16], [399, 0, 1, 16]])  # y mirrored
    assert test.protocol.startswith("MultiviewX, test split (2 frames, 360 to 399)")
    assert test.area == (0.0, 25.0, 0.0, 16.0)


def test_a_part_without_the_split_is_named(tmp_path):
    write_annotations(tmp_path, (0, 5), 7, (0, 1))
    with pytest.raises(InvalidInputError, match="no annotations of the test split of WildTrack"):
        read_ground_truth(tmp_path)


def test_other_annotations_are_refused(tmp_path):
    with pytest.raises(InvalidInputError, match="holds no annotations"):
        read_ground_truth(tmp_path)
    write_annotations(tmp_path, (0,), 3, (0, 1))
    with pytest.raises(FileFormatError, match="annotations of 3 cameras; WildTrack has 7"):
        read_ground_truth(tmp_path)


@pytest.mark.parametrize("name", ["truth.json", "TRUTH.JSON"])
def test_uniform_json_brings_its_area(name, tmp_path):
    document = {
        "units": "m",
        "cameras": [{"name": "a"}],
        "frames": [
            {"frame": 3, "gt": [{"id": 4, "x": 1, "y": 2}], "views": {}},
            {"frame": 4, "views": {}},
        ],
        "evaluation_area": {"x": [0, 5], "y": [0, 6]},
    }
    path = tmp_path / name
    path.write_text(json.dumps(document))
    truth = read_ground_truth(path)
    np.testing.assert_array_equal(truth.rows, [[3, 4, 1, 2]])
    np.testing.assert_array_equal(truth.frames, [3, 4])
    assert truth.area == (0, 5, 0, 6)
    document["frames"] = [{"frame": 3, "views": {}}]
    path.write_text(json.dumps(document))
    with pytest.raises(InvalidInputError, match="no true positions"):
        read_ground_truth(path)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("identity", ["id", "track_id", "ID"])
def test_truth_and_tracks_are_read_alike(identity, separator, tmp_path):
    truth = tmp_path / "truth.csv"
    text = f"X,Frame,Y,{identity}\n \n1.5,0,2.5,7\n3,1,4,8\n"
    truth.write_text(text.replace(",", separator))
    np.testing.assert_array_equal(read_ground_truth(truth).rows, [[0, 7, 1.5, 2.5], [1, 8, 3, 4]])


def test_frames_may_be_nanoseconds(tmp_path):
    truth = tmp_path / "truth.csv"
    truth.write_text("frame,id,x,y\n1700000000000000000,7,1.5,2.5\n1.7000000002e18,7,1,2\n")
    rows = read_ground_truth(truth).rows
    assert rows[:, 0].astype(int).tolist() == [1_700_000_000_000_000_000, 1_700_000_000_200_000_000]
    assert hota(rows, rows).hota == 100


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("frame,x,y\n0,1,2\n", "no column 'id'"),
        ("", "no column 'frame'"),
        ("frame,id,x,y\n0,1,here,2\n", "here"),
        ("frame,id,x,y\n0,1,2,3\n\n0,1,2\n", r"truth\.csv: line 4 has 3 columns instead of 4"),
        ("frame,id,x,y\n0,1,1,5,2,5\n", "line 2 has 6 columns.*decimals with a point"),
        ("frame,id,x,y\n", "has a header but no rows"),
        ("frame,id,x,y,x\n0,1,2,3,4\n", "has two columns 'x'. Keep one"),
        ("frame,id,x,y\n0,1,2,3\n1,1,nan,3\n", r"truth\.csv: x in line 3 is 'nan'"),
        ("frame,id,x,y\n0.5,1,2,3\n", "frame in line 2 is '0.5', not a whole number"),
        ("frame,id,x,y\n9e18,1,2,3\n1e19,1,2,3\n", "frame in line 3 is '1e19', not a whole number"),
        ("frame,id,x,y\n0,,2,3\n", "id in line 2 is '', not a whole number"),
        ("frame,id,x,y\n9007199254740993,1,2,3\n", "'9007199254740993', not .* double precision"),
        ("frame,id,x,y\n1,-1,0,0\n1,-1,5,0\n1,3,1,2\n2,3,1,2\n1,3,3,2\n", "lines 4 and 6 both say"),
        ("frame,id,x,y\n0,1,2," + "3" * 200_000, "line 2 is not valid CSV"),
    ],
)
def test_truth_that_is_none_is_refused(text, sentence, tmp_path):
    truth = tmp_path / "truth.csv"
    truth.write_text(text)
    with pytest.raises(FileFormatError, match=sentence):
        read_ground_truth(truth)


def test_a_table_of_parquet_is_no_truth(tmp_path):
    truth = tmp_path / "tracks.parquet"
    with pytest.raises(InvalidInputError, match="There is no file"):
        read_ground_truth(truth)
    truth.write_bytes(b"PAR1\xe5")
    sentence = r"tracks\.parquet is a Parquet table; ground truth is a CSV file with a header"
    with pytest.raises(FileFormatError, match=sentence):
        read_ground_truth(truth)


@pytest.mark.slow
def test_the_published_sample_of_multiviewx(shared):
    folder = shared / "data" / "real" / "multiviewx_demo10_original"
    truth = read_ground_truth(folder, "all")
    assert truth.protocol.startswith("MultiviewX, all frames (10 frames, 0 to 9)")
    expected = read_multiviewx(folder, drop_unseen=True).ground_truth
    np.testing.assert_array_equal(truth.rows, expected)
