from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.adapters.detectors._tiling import cut_by_window, tile_windows
from catfree.errors import InvalidInputError


@given(
    st.integers(1, 2000),
    st.integers(1, 2000),
    st.tuples(st.integers(1, 5), st.integers(1, 5)),
    st.floats(0, 0.6),
)
def test_tiles_cover_every_pixel_and_stay_inside(width, height, tiles, overlap):
    whole, *rest = tile_windows(width, height, tiles, overlap)
    assert whole == (0, 0, width, height)
    columns, rows = np.zeros(width, bool), np.zeros(height, bool)
    for x1, y1, x2, y2 in rest or [whole]:
        assert 0 <= x1 < x2 <= width
        assert 0 <= y1 < y2 <= height
        columns[x1:x2], rows[y1:y2] = True, True
    assert columns.all()
    assert rows.all()


@given(st.integers(200, 2000), st.integers(2, 5), st.floats(0.05, 0.6))
def test_neighbours_share_the_overlap(width, count, overlap):
    tiles = tile_windows(width, 1, (count, 1), overlap)[1:]
    assert len(tiles) == count
    for left, right in pairwise(tiles):
        assert left[2] - right[0] >= overlap * (left[2] - left[0]) - 2


def test_only_inner_edges_cut():
    box = np.array([[0, 0, 50, 50], [40, 10, 99, 50], [99, 10, 120, 50], [60, 60, 90, 100.0]])
    cut = cut_by_window(box, (0, 0, 100, 100), (200, 100), margin=2.0)
    np.testing.assert_array_equal(cut, [False, True, True, False])


@pytest.mark.parametrize(("tiles", "overlap"), [(0, 0.2), ((2, -1), 0.2), (2, 1.0), (2, -0.1)])
def test_impossible_tiles(tiles, overlap):
    with pytest.raises(InvalidInputError, match="tiles must be positive"):
        tile_windows(10, 10, tiles, overlap)
