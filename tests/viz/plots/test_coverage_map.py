"""Coverage drawn as a map."""

from dataclasses import replace

import numpy as np
import pytest

from catfree._coverage import coverage
from catfree.errors import InvalidInputError
from catfree.synthetic import make_layout
from catfree.viz.plots._coverage_map import iso_levels, plot_coverage

AREA = (-6.0, 6.0, -5.0, 5.0)


def test_iso_levels_are_round_and_inside():
    levels = iso_levels(np.append(np.geomspace(0.03, 4.0, 500), np.inf))
    assert 3 <= len(levels) <= 6
    assert ((levels > 0.03) & (levels < 4)).all()
    assert set(np.round(levels / 10 ** np.floor(np.log10(levels) + 1e-9), 6)) <= {1, 2, 3, 5, 7}
    assert len(iso_levels(np.full((3, 3), np.inf))) == 0


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["sigma", "cameras"])
def test_maps_show_the_numbers(quantity):
    scene = make_layout("ring4", 3).scene
    result = coverage(scene, AREA, resolution=0.5)
    ax = plot_coverage(result, scene, quantity=quantity)
    ax.figure.canvas.draw()
    shown = ax.images[0].get_array()
    expected = result.sigma if quantity == "sigma" else result.cameras
    finite = np.isfinite(expected)
    np.testing.assert_allclose(shown[finite], expected[finite])
    assert tuple(ax.images[0].get_extent()) == pytest.approx(result.area)
    assert {text.get_text() for text in ax.texts} >= {"C1", "C2", "C3", "C4"}


@pytest.mark.slow
def test_tracks_are_drawn_over_the_map(world, localization):
    result = coverage(world.scene, resolution=float(world.scene.extent) / 20)
    bare = plot_coverage(result, world.scene)
    both = plot_coverage(result, world.scene, localization=localization)
    both.figure.canvas.draw()
    people = np.unique(localization.tracks.track_id)
    assert len(both.lines) == len(bare.lines) + len(people)
    drawn = np.concatenate([line.get_xydata() for line in both.lines])
    for xy in localization.tracks.ground_xy[::7]:
        assert np.isclose(drawn, xy, rtol=1e-6).all(-1).any()


@pytest.mark.slow
def test_a_map_without_any_coverage_can_be_drawn():
    scene = make_layout("ring4", 3).scene
    far = coverage(scene, (500.0, 520.0, 500.0, 520.0), resolution=5.0)
    blind = replace(far, visible=np.zeros_like(far.visible), sigma=np.full_like(far.sigma, np.inf))
    assert blind.accuracy == 0
    plot_coverage(blind, scene).figure.canvas.draw()
    with pytest.raises(InvalidInputError, match="quantity"):
        plot_coverage(blind, scene, quantity="colour")
