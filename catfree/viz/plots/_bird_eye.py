"""The scene from above: tracks, their uncertainty, and the cameras."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from catfree.errors import InvalidInputError
from catfree.evaluation._rows import as_rows
from catfree.types import Localization, Origin, Scene, Tracks
from catfree.types._scene import require_scene
from catfree.types._validation import (
    as_area,
    as_count,
    as_integer,
    as_number,
    is_listed,
    require_instance,
)
from catfree.viz._palette import CAMERA_COLOR, TRUTH_COLOR, fraction, line_style, track_color
from catfree.viz._plan_view import (
    camera_names as names_of,
    camera_wedges,
    confidence_ellipse,
    length_unit,
    place_labels,
    view_area,
)
from catfree.viz.plots._axes import axes_or_new, figure_of, plain_label, show_ground

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_bird_eye(
    localization: Localization,
    scene: Scene,
    *,
    ax: "Axes | None" = None,
    ground_truth: Any = None,
    area: Any = None,
    frames: Iterable[int | np.integer] | int | np.integer | None = None,
    camera_names: Sequence[str] | None = None,
    confidence: float = 0.95,
    detail_limit: int = 60,
    legend: bool = True,
) -> "Axes":
    """Draw tracks on the ground with identities, uncertainty, cameras and, if given, the truth.

    Every track is a line that ends in a dot with its identity and an ellipse that holds the true
    position with probability `confidence`. Hollow dots are extended or interpolated positions.
    Each identity has the same color in every picture of catfree.

    Args:
        localization: the result of `cf.localize`.
        scene: the scene it was computed with.
        ax: matplotlib axes to draw on; None for a new figure.
        ground_truth: (N, 4) rows [frame, id, x, y] in the ground coordinates of the scene, or None.
        area: (x_min, x_max, y_min, y_max) to outline with a dashed line, such as the evaluation
            area, or a mapping with the pairs `x` and `y`, or None.
        frames: the frames to draw, or one frame; None for all.
        camera_names: (C,) labels of the cameras; None for C1, C2, ...
        confidence: probability of the ellipses.
        detail_limit: the number of longest tracks drawn with identity, ellipse and added positions;
            the others are thin lines, because more would be indistinguishable.
        legend: whether to draw a legend.

    Returns:
        The axes, in ground coordinates (meters for a metric scene) with equal scales.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
        InvalidInputError: if confidence, area, frames, ground truth or camera names are invalid.
    """
    require_instance(localization, Localization, "localization")
    require_scene(scene)
    if not 0 < as_number(confidence, "confidence") < 1:
        raise InvalidInputError(f"confidence is {confidence}; it must be between 0 and 1.")
    detail_limit = as_count(detail_limit, "detail_limit")
    outline = None if area is None else as_area(area)
    tracks = localization.tracks
    truth = as_rows([] if ground_truth is None else ground_truth, "ground_truth")
    if frames is not None:
        listed: Any = frames
        chosen = as_integer(list(listed) if is_listed(listed) else listed, "frames")
        tracks = tracks[np.isin(tracks.frame, chosen)]
        truth = truth[np.isin(truth[:, 0], chosen)]

    view = view_area(scene, np.concatenate([tracks.ground_xy, truth[:, 2:]]), outline)
    ax = axes_or_new(ax, view)
    if outline is not None:
        corners = [outline[i] for i in (0, 1, 1, 0, 0)], [outline[i] for i in (2, 2, 3, 3, 2)]
        ax.plot(*corners, color="0.55", linewidth=1, linestyle=(0, (6, 4)), zorder=1)
    color = (*fraction(TRUTH_COLOR), 0.45)
    ax.scatter(*truth[:, 2:].T, marker="+", s=22, linewidths=0.7, zorder=2, color=color)
    ends = _draw_tracks(ax, tracks, confidence, detail_limit)
    show_ground(ax, view, length_unit(scene))
    ax.tick_params(labelsize=8)
    occupied = draw_cameras(ax, scene, names_of(scene.rig, camera_names))
    texts = [str(identity) for identity, _ in ends]
    colors = [fraction(track_color(identity)) for identity, _ in ends]
    _write(ax, [end for _, end in ends], texts, colors, occupied, size=7.5, weight="normal")
    if legend:
        _explain(ax, confidence, with_truth=len(truth) > 0, with_area=area is not None)
    return ax


def draw_cameras(ax: "Axes", scene: Scene, names: Sequence[str]) -> np.ndarray:
    """Draw the cameras with field of view and name; return the labels' display rectangles (K, 4).

    The axes' limits must be final. Unregistered cameras are left out.
    """
    from matplotlib.patheffects import withStroke

    color = fraction(CAMERA_COLOR)
    wedges = camera_wedges(scene)
    halo = [withStroke(linewidth=2.2, foreground="white")]  # for dark maps beneath
    look = {"facecolor": (*color, 0.16), "edgecolor": (*color, 0.8), "linewidth": 0.8}
    for wedge in wedges.values():
        ax.fill(*wedge.T, **look, zorder=3, path_effects=halo)
        ax.plot(*wedge[0], "s", markersize=4.5, color=color, zorder=6, path_effects=halo)
    anchors = [wedge[0] for wedge in wedges.values()]
    figure_of(ax).draw_without_rendering()  # lays out the figure: pixels are final from here on
    texts = [plain_label(names[camera]) for camera in wedges]
    at, half = ax.transData.transform(np.reshape(anchors, (-1, 2))), 4.0
    squares = np.concatenate([at - half, at + half], axis=-1)
    return _write(ax, anchors, texts, [color] * len(texts), squares, size=9.0, weight="bold")


def _draw_tracks(
    ax: "Axes", tracks: Tracks, confidence: float, detail_limit: int
) -> list[tuple[int, np.ndarray]]:
    """Draw every track; return the identity and last position of each, the longest first."""
    identities, lengths = np.unique(tracks.track_id, return_counts=True)
    tracked = identities >= 0
    hollow = {"markerfacecolor": "white", "markersize": 3.2, "markeredgewidth": 0.9}
    ends = []
    for identity in identities[tracked][np.argsort(-lengths[tracked], kind="stable")].tolist():
        one = tracks[tracks.track_id == identity]
        color, style = fraction(track_color(identity)), line_style(identity)
        if len(ends) >= detail_limit:
            ax.plot(*one.ground_xy.T, style, color=color, linewidth=0.7, alpha=0.6, zorder=2)
            continue
        ax.plot(*one.ground_xy.T, style, color=color, linewidth=1.3, zorder=4)
        added = one[one.origin != Origin.DETECTED].ground_xy
        ax.plot(*added.T, "o", color=color, zorder=5, **hollow)
        if one.origin[-1] == Origin.DETECTED:
            ax.plot(*one.ground_xy[-1], "o", color=color, markersize=4, zorder=5)
        _draw_ellipse(ax, one[-1:], color, confidence)
        ends.append((identity, one.ground_xy[-1]))
    loose = tracks[tracks.track_id < 0]
    color = fraction(track_color(-1))
    ax.plot(*loose.ground_xy.T, "o", color=color, markersize=2.5, zorder=2)
    if len(loose) <= detail_limit:
        _draw_ellipse(ax, loose, color, confidence)
    return ends


def _draw_ellipse(
    ax: "Axes", tracks: Tracks, color: tuple[float, float, float], confidence: float
) -> None:
    from matplotlib.patches import Ellipse

    finite = np.isfinite(tracks.covariance).all((-1, -2))
    look = {"facecolor": (*color, 0.13), "edgecolor": (*color, 0.8), "linewidth": 0.8}
    for xy, covariance in zip(tracks.ground_xy[finite], tracks.covariance[finite], strict=True):
        major, minor, angle = confidence_ellipse(covariance, confidence)
        size = {"width": 2 * major, "height": 2 * minor, "angle": float(np.degrees(angle))}
        ax.add_patch(Ellipse(xy, **size, **look, zorder=3))


def _write(
    ax: "Axes",
    anchors: Sequence[np.ndarray],
    texts: Sequence[str],
    colors: Sequence[tuple[float, float, float]],
    occupied: np.ndarray,
    *,
    size: float,
    weight: str,
) -> np.ndarray:
    """Write labels that cover neither each other nor `occupied`; return all rectangles (K, 4)."""
    from matplotlib.patheffects import withStroke

    at = ax.transData.transform(np.reshape(anchors, (-1, 2)))
    pixels = figure_of(ax).dpi / 72 * size
    sizes = np.array([[0.62 * pixels * len(text), pixels] for text in texts]).reshape(-1, 2)
    box = ax.get_window_extent()
    bounds = box.x0, box.x1, box.y0, box.y1
    places, occupied = place_labels(at, sizes, bounds, occupied, gap=0.5 * pixels)
    back = ax.transData.inverted()
    for text, color, place in zip(texts, colors, places, strict=True):
        if place is not None:
            x, y = back.transform(place[:2])
            label = ax.text(
                x,
                y,
                text,
                color=color,
                fontsize=size,
                zorder=8,
                weight=weight,
                ha="left",
                va="bottom",
            )
            label.set_path_effects([withStroke(linewidth=2.2, foreground="white")])
    return occupied


def _explain(ax: "Axes", confidence: float, *, with_truth: bool, with_area: bool) -> None:
    from matplotlib.lines import Line2D

    def mark(label: str, marker: str = "", line: Any = "", **style: Any) -> Line2D:
        return Line2D([], [], marker=marker, linestyle=line, label=label, **style)

    gray = fraction(track_color(-1))
    marks = [
        mark("track, last position", "o", "-", color=gray, markersize=4),
        mark("extended or interpolated", "o", color=gray, markerfacecolor="white", markersize=4),
        mark(
            f"{100 * confidence:g} % ellipse",
            "o",
            color=(*gray, 0.25),
            markersize=10,
            markeredgecolor=gray,
        ),
        mark("camera and field of view", "s", color=fraction(CAMERA_COLOR), markersize=4.5),
    ]
    if with_truth:
        marks.append(mark("ground truth", "+", color=fraction(TRUTH_COLOR), alpha=0.6))
    if with_area:
        marks.append(mark("area", line=(0, (6, 4)), color="0.55"))
    ax.legend(
        handles=marks,
        fontsize=7.5,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=3,
        frameon=False,
    )
