import inspect
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from matplotlib import pyplot
from matplotlib.colors import to_rgb
from matplotlib.patches import Ellipse

import catfree as cf
from catfree.errors import InvalidInputError, MissingDependencyError
from catfree.geometry._plane import from_plan, to_plan
from catfree.types import Fate, Localization, Origin, Tracks
from catfree.viz import plot_bird_eye, plot_gates
from catfree.viz._palette import FATE_COLORS, TRACK_COLORS, fraction, line_style, track_color
from catfree.viz._plan_view import camera_wedges, confidence_ellipse, place_labels, view_area
from catfree.viz.plots._axes import plain_label
from catfree.viz.plots._threshold_plot import gate_samples

ANGLES = st.floats(-3.0, 3.0)


@given(major=st.floats(0.1, 10.0), ratio=st.floats(0.05, 0.95), angle=ANGLES)
def test_ellipse_axes_are_those_of_the_covariance(major, ratio, angle):
    axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    covariance = axes @ np.diag([major**2, (ratio * major) ** 2]) @ axes.T
    long, short, turn = confidence_ellipse(covariance, 0.95)
    quantile = 2.447746830680816  # square root of the chi-square 95 % quantile, two degrees
    np.testing.assert_allclose([long, short], [quantile * major, quantile * ratio * major])
    assert np.sin(turn - angle) == pytest.approx(0, abs=1e-6)


@given(confidence=st.floats(0.05, 0.99), seed=st.integers(0, 100))
def test_ellipses_hold_the_stated_share(confidence, seed):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(2, 2)) + 2 * np.eye(2)
    samples = rng.normal(size=(20_000, 2)) @ factor.T
    major, minor, angle = confidence_ellipse(factor @ factor.T, confidence)
    turned = samples @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    inside = ((turned / [major, minor]) ** 2).sum(-1) <= 1
    assert inside.mean() == pytest.approx(confidence, abs=0.016)


def test_ground_coordinates_return(world):
    xy = np.random.default_rng(0).normal(size=(20, 2))
    points = from_plan(world.scene, xy)
    np.testing.assert_allclose(world.scene.ground.signed_distance(points), 0, atol=1e-6)
    np.testing.assert_allclose(to_plan(world.scene, points), xy, atol=1e-6)


def test_wedges_follow_the_field_of_view(world):
    scene, rig = world.true_scene, world.true_rig
    for camera in range(4):
        wedge = camera_wedges(scene)[camera]
        np.testing.assert_allclose(wedge[0], rig.centers[camera, :2], atol=1e-5)
        width, height = rig.image_size[camera]
        for edge, column in ((1, -0.5), (2, width - 0.5)):
            pixel = np.array([column, (height - 1) / 2, 1.0])
            ray = (rig.R[camera].T @ np.linalg.solve(rig.K[camera], pixel))[:2]
            expected = 0.08 * float(scene.extent) * ray / np.linalg.norm(ray)
            np.testing.assert_allclose(wedge[edge] - wedge[0], expected, atol=1e-5)


def test_the_view_holds_cameras_and_area(world):
    scene = world.true_scene
    x_min, x_max, y_min, y_max = view_area(scene, np.zeros((0, 2)), (-40.0, 1.0, 2.0, 50.0))
    x, y = scene.rig.centers[:, :2].T
    assert x_min < min(-40, x.min())
    assert max(1.0, x.max()) < x_max
    assert y_min < min(2.0, y.min())
    assert max(50.0, y.max()) < y_max


@given(
    anchors=st.lists(st.tuples(st.floats(0, 200), st.floats(0, 200)), min_size=1, max_size=40),
    width=st.integers(5, 40),
)
def test_labels_never_cover_each_other(anchors, width):
    sizes = np.tile([float(width), 10.0], (len(anchors), 1))
    occupied = np.array([[90.0, 90.0, 110.0, 110.0]])
    places, taken = place_labels(np.array(anchors), sizes, (0.0, 200.0, 0.0, 200.0), occupied, 4.0)
    boxes = [place.tolist() for place in places if place is not None]
    assert taken.tolist() == [*occupied.tolist(), *boxes]
    for at, one in enumerate(boxes):
        assert min(one) >= 0
        np.testing.assert_allclose([one[2] - one[0], one[3] - one[1]], [width, 10])
        assert max(one) <= 200
        for other in [*boxes[:at], tuple(occupied[0])]:
            apart_x = one[0] >= other[2] or other[0] >= one[2]
            assert apart_x or one[1] >= other[3] or other[1] >= one[3]
    far = [(0.0, 0.0), (100.0, 50.0), (0.0, 180.0)]
    sizes, bounds = sizes[:1].repeat(3, 0), (0.0, 200.0, 0.0, 200.0)
    places, _ = place_labels(np.array(far), sizes, bounds, np.zeros((0, 4)), 4.0)
    assert all(place is not None for place in places)


def test_colours_are_distinct_and_stay_with_the_identity():
    assert len(set(TRACK_COLORS)) == len(TRACK_COLORS) == 12
    assert len({(track_color(i), line_style(i)) for i in range(36)}) == 36
    assert track_color(3) == track_color(np.int64(3))
    assert track_color(-1) not in TRACK_COLORS
    assert set(FATE_COLORS) == set(Fate)
    assert len(set(FATE_COLORS.values())) == len(Fate)


@pytest.mark.slow
@pytest.mark.parametrize("frames", [None, range(5), 3])
def test_bird_eye_draws_every_track_ellipse_and_camera(world, localization, frames):
    ax = plot_bird_eye(localization, world.scene, frames=frames)
    ax.figure.canvas.draw()
    tracks = localization.tracks
    if frames is not None:
        tracks = tracks[np.isin(tracks.frame, frames if frames == 3 else list(frames))]
    ellipses = {tuple(np.round(p.center, 9)): p for p in ax.patches if isinstance(p, Ellipse)}
    for identity in np.unique(tracks.track_id):
        one = tracks[tracks.track_id == identity]
        drawn = [line for line in ax.lines if np.array_equal(line.get_xydata(), one.ground_xy)]
        assert any(to_rgb(line.get_color()) == fraction(track_color(identity)) for line in drawn)
        if np.isfinite(one.covariance[-1]).all():
            shown = ellipses[tuple(np.round(one.ground_xy[-1], 9))]
            major, minor, _ = confidence_ellipse(one.covariance[-1])
            assert (shown.width, shown.height) == pytest.approx((2 * major, 2 * minor))
    hollow = sum(
        len(line.get_xdata()) for line in ax.lines if line.get_markerfacecolor() == "white"
    )
    assert hollow == (tracks.origin != Origin.DETECTED).sum()
    assert {"C1", "C2", "C3", "C4"} <= {text.get_text() for text in ax.texts}
    assert "scene units" in ax.get_xlabel()
    assert ax.get_aspect() == 1


def crowd(localization):
    """Simulate forty people who walk in one square."""
    rng = np.random.default_rng(0)
    frame, identity = (column.ravel() for column in np.meshgrid(range(8), range(40)))
    start, step = rng.uniform(-0.3, 0.3, (40, 1, 2)), rng.normal(0, 0.02, (40, 8, 2))
    xy = (start + step.cumsum(1)).reshape(-1, 2)
    whole = np.zeros(320, np.int64)
    tracks = Tracks(
        frame=frame,
        track_id=identity,
        position=np.pad(xy, ((0, 0), (0, 1))),
        ground_xy=xy,
        sigma=np.full(320, 0.01),
        covariance=np.tile(1e-4 * np.eye(2), (320, 1, 1)),
        supporting_cameras=whole + 3,
        origin=whole,
    )
    return Localization(
        tracks, localization.candidates, localization.thresholds, localization.reliability
    )


@pytest.mark.slow
def test_labels_do_not_overlap_in_a_crowded_picture(world, localization):
    found = crowd(localization)
    ax = plot_bird_eye(found, world.scene)
    figure = ax.figure
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert len(boxes) >= 30
    for at, one in enumerate(boxes):
        for other in boxes[:at]:
            width = min(one.x1, other.x1) - max(one.x0, other.x0)
            height = min(one.y1, other.y1) - max(one.y0, other.y0)
            assert min(width, height) <= 3  # pixels: descent and white border


@pytest.mark.slow
def test_truth_area_and_metres_in_a_metric_scene(world):
    found = cf.localize(world.detections, world.true_scene, cf.Settings.paper())
    ax = plot_bird_eye(
        found,
        world.true_scene,
        ground_truth=world.ground_truth,
        area=world.area,
        camera_names=["north", "east", "south", "west"],
    )
    ax.figure.canvas.draw()
    truth = ax.collections[0].get_offsets()
    np.testing.assert_allclose(truth, world.ground_truth[:, 2:])
    assert "(m)" in ax.get_xlabel()
    assert "north" in {text.get_text() for text in ax.texts}


@pytest.mark.slow
def test_nothing_found_is_a_picture_of_the_cameras(world):
    empty = cf.localize(world.detections[:0], world.scene)
    ax = plot_bird_eye(empty, world.scene)
    ax.figure.canvas.draw()
    assert len(ax.texts) == 4
    for axes in plot_gates(empty, world.scene):
        axes.figure.canvas.draw()


@pytest.mark.slow
def test_positions_without_identity_are_grey_dots(world):
    settings = cf.Settings.paper()
    loose = replace(settings, trajectories=replace(settings.trajectories, enabled=False))
    found = cf.localize(world.detections, world.scene, loose)
    ax = plot_bird_eye(found, world.scene)
    dots = [line for line in ax.lines if len(line.get_xdata()) == len(found.tracks)]
    assert to_rgb(dots[0].get_color()) == fraction(track_color(-1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"confidence": 1.0}, "confidence"),
        ({"area": (1.0, 0.0, 0.0, 1.0)}, "area"),
        ({"area": 5}, "area is 5"),
        ({"area": (0.0, np.inf, 0.0, 1.0)}, "finite"),
        ({"camera_names": ["a"]}, "1 names"),
        ({"frames": [0.5]}, r"frames\[0\] is 0.5; it must be a whole number"),
        ({"confidence": "0.9"}, "confidence is '0.9'; it must be a finite number"),
        ({"ground_truth": np.zeros((3, 2))}, "ground_truth"),
    ],
)
def test_impossible_arguments_are_named(world, localization, arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        inspect.unwrap(plot_bird_eye)(localization, world.scene, **arguments)


@pytest.mark.slow
def test_a_radius_of_suppression_is_positive(world, localization):
    with pytest.raises(InvalidInputError, match="suppression_radius is 0"):
        plot_gates(localization, world.scene, suppression_radius=0.0)


@pytest.mark.slow
def test_gates_count_every_candidate_once(world, localization):
    axes = plot_gates(localization, world.scene)
    axes[0].figure.canvas.draw()
    thresholds, candidates = localization.thresholds, localization.candidates
    radius = 0.018 * float(world.scene.extent)
    for ax, chosen, value in zip(
        axes, gate_samples(localization), (thresholds.tau_sigma, thresholds.tau_g), strict=True
    ):
        heights = sum(patch.get_height() for c in ax.containers for patch in c)
        assert heights == chosen.sum()
        assert ax.get_xscale() == "log"
        assert any(np.allclose(line.get_xdata(), value / radius) for line in ax.lines)
    first, second = gate_samples(localization)
    assert not (candidates.fate[first] == Fate.RMS_GATE).any()
    accepted = candidates.fate == Fate.ACCEPTED
    assert (second | ~accepted).all()
    assert (candidates.ground_distance[accepted] <= thresholds.tau_g).all()


@pytest.mark.slow
def test_given_axes_are_used(world, localization):
    figure, (left, right) = pyplot.subplots(1, 2)
    assert plot_bird_eye(localization, world.scene, ax=left, legend=False) is left
    assert left.get_legend() is None
    assert plot_gates(localization, world.scene, axes=(left, right)) == (left, right)
    assert pyplot.get_fignums() == [figure.number]


@pytest.mark.slow
def test_without_matplotlib_the_error_names_the_command(world, localization, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'catfree\[plot\]'"):
        plot_bird_eye(localization, world.scene)
    with pytest.raises(MissingDependencyError, match=r"pip install 'catfree\[plot\]'"):
        plot_gates(localization, world.scene)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lobby$a_b_c$", "$$", "大厅🎥", "a\nb", "x" * 700])
def test_names_of_cameras_are_no_formulas_and_need_no_glyphs(name, world, localization, tmp_path):
    # Warnings are errors in these tests.
    names = [name, "b", "c", "d"]
    drawn = plot_bird_eye(localization, world.scene, camera_names=names)
    drawn.figure.savefig(tmp_path / "a.png")
    texts = [text.get_text() for text in drawn.texts]
    assert "b" in texts
    assert all(len(text) < 200 for text in texts)


def test_a_dollar_is_drawn_as_a_dollar():
    assert plain_label("a$b_c$") == r"a\$b_c\$"
    assert plain_label("north 大厅") == "north ??"
