"""Laws of the heat map: it counts places of many people, and reveals nothing about the others."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.errors import InvalidInputError
from catfree.types import Tracks
from catfree.viz import heat_map, plot_heat_map, write_heat_map

NEVER = 10**6


def tracks_of(track_id, xy):
    n, points = len(track_id), np.asarray(xy, float).reshape(-1, 2)
    flat = np.column_stack([points, np.zeros(n)])
    return Tracks(
        np.arange(n), np.asarray(track_id, int), flat, points, np.full(n, 0.1),
        np.tile(0.01 * np.eye(2), (n, 1, 1)), np.full(n, 2), np.zeros(n, int),
    )  # fmt: skip


ROWS = st.lists(
    st.tuples(st.integers(-1, 6), st.integers(-20, 20), st.integers(-20, 20)), max_size=60
)


def walks(rows):
    """Make tracks from identities and places, a quarter of a cell from the borders."""
    xy = [(x / 2 + 0.25, y / 2 + 0.25) for _, x, y in rows]
    return tracks_of([identity for identity, _, _ in rows], xy)


@given(rows=ROWS, k=st.integers(1, 5))
def test_cells_are_shown_where_k_people_were_and_count_their_positions(rows, k):
    tracks = walks(rows)
    heat = heat_map(tracks, 1.0, k)
    assert heat.positions.shape == (len(heat.y), len(heat.x))
    known = tracks.track_id >= 0
    cells = {}
    for identity, place in zip(tracks.track_id[known], tracks.ground_xy[known], strict=True):
        cells.setdefault(tuple(np.floor(place) + 0.5), []).append(identity)
    wanted = {place: len(ids) for place, ids in cells.items() if len(set(ids)) >= k}
    row, column = np.nonzero(np.isfinite(heat.positions))
    found = {(heat.x[c], heat.y[r]): heat.positions[r, c] for r, c in zip(row, column, strict=True)}
    assert found == wanted


@given(rows=ROWS, k=st.integers(2, 5), seed=st.integers(0, 99))
def test_nothing_shows_where_a_single_person_went_alone(rows, k, seed):
    """A loner elsewhere changes neither values nor extent."""
    tracks = walks(rows)
    far = np.random.default_rng(seed).uniform(50, 60, (7, 2))
    alone = np.full(7, NEVER)
    more = tracks_of(
        np.concatenate([tracks.track_id, alone]), np.concatenate([tracks.ground_xy, far])
    )
    one, other = heat_map(tracks, 1.0, k), heat_map(more, 1.0, k)
    for name in ("x", "y", "positions"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@given(rows=ROWS, k=st.integers(1, 4), seed=st.integers(0, 99))
def test_order_and_numbering_of_people_do_not_matter(rows, k, seed):
    tracks = walks(rows)
    rng = np.random.default_rng(seed)
    names, order = rng.permutation(7), rng.permutation(len(tracks))
    renamed = np.where(tracks.track_id >= 0, names[tracks.track_id], -1)[order]
    one, other = (
        heat_map(tracks, 1.0, k),
        heat_map(tracks_of(renamed, tracks.ground_xy[order]), 1, k),
    )
    np.testing.assert_array_equal(one.positions, other.positions)


@given(rows=ROWS)
def test_more_people_needed_show_fewer_cells(rows):
    tracks = walks(rows)
    shown = [np.isfinite(heat_map(tracks, 1.0, k).positions).sum() for k in range(1, 6)]
    assert shown == sorted(shown, reverse=True)


def test_borders_are_multiples_of_the_cell():
    heat = heat_map(tracks_of([0, 1], [(0.6, -0.1), (0.7, -0.2)]), 0.5, 2)
    np.testing.assert_allclose([heat.x, heat.y], [[0.75], [-0.25]])
    assert heat.positions.tolist() == [[2.0]]


@pytest.mark.parametrize(("cell", "k"), [(0, 5), (-1, 5), (np.nan, 5), (1, 0)])
def test_lengths_and_counts_are_checked(cell, k):
    with pytest.raises(InvalidInputError, match=r"cell|k"):
        heat_map(tracks_of([0], [(0, 0)]), cell, k)


def test_a_map_too_large_or_too_fine_is_refused():
    far = tracks_of([0, 0], [(0, 0), (1e5, 1e5)])
    with pytest.raises(InvalidInputError, match="cells"):
        heat_map(far, 0.5, 1)
    with pytest.raises(InvalidInputError, match="too small"):
        heat_map(far, 1e-12, 1)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_positions_of_people_are_finite(bad):
    with pytest.raises(InvalidInputError, match=r"ground_xy\[1, 0\] is not finite"):
        heat_map(tracks_of([0, 0], [(0, 0), (bad, 0)]), 1.0, 1)
    assert heat_map(tracks_of([0, -1], [(0, 0), (bad, 0)]), 1.0, 1).positions.tolist() == [[1.0]]


def test_the_file_has_the_cells_that_are_shown(tmp_path):
    heat = heat_map(tracks_of([0, 1, 2], [(0.5, 0.5), (0.5, 0.5), (5, 5)]), 1.0, 2)
    lines = write_heat_map(tmp_path / "heat.csv", heat).read_text().splitlines()
    assert lines == ["x,y,positions", "0.5,0.5,2"]
    nobody = heat_map(tracks_of([], []), 1.0)
    assert write_heat_map(tmp_path / "heat.csv", nobody).read_text() == "x,y,positions\n"
    with pytest.raises(InvalidInputError, match=r"name .*heat\.csv"):
        write_heat_map(tmp_path / "heat.PNG", heat)  # the picture's path


@pytest.mark.slow
def test_the_picture_has_the_extent_of_the_cells():
    heat = heat_map(tracks_of([0, 1, 2, 3], [(0.5, 0.5), (0.6, 0.5), (3.5, 1.5), (3.5, 1.5)]), 1, 2)
    ax = plot_heat_map(heat)
    np.testing.assert_allclose([*ax.get_xlim(), *ax.get_ylim()], [0, 4, 0, 2])
    assert plot_heat_map(heat_map(tracks_of([], []), 1.0)).get_xlabel() == "ground x (m)"
