"""`Tracks` and `Candidates`: rows, counts and files."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree import Candidates, Fate, Tracks
from catfree.errors import FileFormatError


def tracks(count: int, dtype=np.float64, *, existence: bool = False) -> Tracks:
    rng = np.random.default_rng(count)
    cameras = rng.integers(0, 5, count)
    return Tracks(
        frame=np.sort(rng.integers(0, 5, count)),
        track_id=rng.integers(0, 3, count),
        position=rng.standard_normal((count, 3)).astype(dtype),
        ground_xy=rng.standard_normal((count, 2)).astype(dtype),
        sigma=np.where(cameras < 2, np.inf, 1.0).astype(dtype),
        covariance=rng.standard_normal((count, 2, 2)).astype(dtype),
        supporting_cameras=cameras,
        origin=rng.integers(0, 3, count),
        existence=rng.random(count).astype(dtype) if existence else None,
    )


@given(st.integers(0, 6), st.sampled_from([np.float32, np.float64]), st.booleans())
def test_a_file_gives_back_every_bit(tmp_path, count, dtype, existence):
    wanted = tracks(count, dtype, existence=existence)
    wanted.save(tmp_path / "tracks.npz")
    again = Tracks.load(tmp_path / "tracks.npz")
    for name, value in vars(wanted).items():
        back = getattr(again, name)
        if value is None:
            assert back is None
        else:
            assert (back.dtype, back.shape) == (value.dtype, value.shape)
            assert back.tobytes() == value.tobytes()


def test_a_file_without_a_column_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", catfree_kind=np.array("Tracks"), frame=np.zeros(0, int))
    with pytest.raises(FileFormatError, match="lacks track_id"):
        Tracks.load(tmp_path / "a.npz")


def test_rows_are_chosen_as_in_numpy():
    some = tracks(5, existence=True)
    chosen = some[some.origin > 0]
    assert some.existence is not None
    np.testing.assert_array_equal(chosen.existence, some.existence[some.origin > 0])
    np.testing.assert_array_equal(some[2].position, some.position[[2]])


def test_rows_for_the_evaluation():
    some = tracks(4)
    np.testing.assert_array_equal(some.to_rows()[:, 0], some.frame)
    np.testing.assert_array_equal(some.to_rows()[:, 2:], some.ground_xy)
    other = np.ones((4, 2))
    np.testing.assert_array_equal(some.to_rows(other)[:, 2:], other)


def test_every_fate_is_counted():
    fate = np.array([Fate.ACCEPTED, Fate.SUPPRESSED, Fate.ACCEPTED], np.int64)
    numbers = np.zeros(3)
    candidates = Candidates(
        frame=np.zeros(3, int),
        position=np.zeros((3, 3)),
        sigma=numbers,
        ground_distance=numbers,
        rms_angle=numbers,
        support=np.zeros((3, 2), int),
        score=numbers,
        fate=fate,
    )
    counts = candidates.count_by_fate()
    assert counts["accepted"] == 2
    assert counts["suppressed"] == 1
    assert sum(counts.values()) == len(candidates) == 3
    assert counts.keys() == {fate.name.lower() for fate in Fate}
