"""Tracks from any file or folder that the library writes."""

import numpy as np
import pytest

from catfree import Clock, Tracks
from catfree.adapters import read_tracks, write_tracks_csv, write_tracks_parquet
from catfree.errors import InvalidInputError


def some_tracks() -> Tracks:
    return Tracks(
        frame=np.array([0, 1]),
        track_id=np.array([3, 3]),
        position=np.array([[1.0, 2, 0], [2, 3, 0]]),
        ground_xy=np.array([[1.0, 2], [2, 3]]),
        sigma=np.full(2, 0.1),
        covariance=np.tile(0.01 * np.eye(2), (2, 1, 1)),
        supporting_cameras=np.full(2, 2),
        origin=np.zeros(2, int),
        clock=Clock(5),
    )


def test_every_form_gives_the_same_rows(tmp_path):
    tracks = some_tracks()
    tracks.save(tmp_path / "tracks.npz")
    paths = [tmp_path / "tracks.npz", tmp_path, write_tracks_csv(tmp_path / "tracks.csv", tracks)]
    pytest.importorskip("pyarrow")
    paths.append(write_tracks_parquet(tmp_path / "tracks.parquet", tracks))
    paths.append(write_tracks_parquet(tmp_path / "T.PARQUET", tracks))
    for path in paths:
        found = read_tracks(path)
        np.testing.assert_array_equal(found.to_rows(), tracks.to_rows())
        assert found.clock == tracks.clock


def test_folders_without_tracks_are_named(tmp_path):
    with pytest.raises(InvalidInputError, match=r"holds no tracks\.csv"):
        read_tracks(tmp_path)
