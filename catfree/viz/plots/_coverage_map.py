"""Maps of coverage: expected uncertainty, or the number of cameras."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from catfree._coverage import Coverage
from catfree.errors import InvalidInputError, quoted
from catfree.types import Localization, Scene
from catfree.types._scene import require_scene
from catfree.types._validation import require_instance
from catfree.viz._palette import fraction, line_style, track_color
from catfree.viz._plan_view import camera_names as names_of, length_unit, view_area
from catfree.viz.plots._axes import axes_or_new, show_ground, show_map
from catfree.viz.plots._bird_eye import draw_cameras

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ISO_LINES = 6  # approximate number of lines of equal sigma


def plot_coverage(
    coverage: Coverage,
    scene: Scene,
    *,
    ax: "Axes | None" = None,
    quantity: str = "sigma",
    localization: Localization | None = None,
    camera_names: Sequence[str] | None = None,
) -> "Axes":
    """Draw expected uncertainty with iso-lines, or the number of cameras, over the ground.

    Args:
        coverage: the result of `cf.coverage`.
        scene: the scene it was computed with.
        ax: matplotlib axes to draw on; None for a new figure.
        quantity: "sigma" for the uncertainty (hatched where fewer than two cameras see the
            ground), "cameras" for the number of cameras that see it.
        localization: result of `cf.localize` whose tracks are drawn on top, or None.
        camera_names: (C,) labels of the cameras; None for C1, C2, ...

    Returns:
        The axes, in ground coordinates.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
        InvalidInputError: if `quantity` is unknown, or an argument has another type.
    """
    require_instance(coverage, Coverage, "coverage")
    require_scene(scene)
    if localization is not None:
        require_instance(localization, Localization, "localization")
    if quantity not in ("sigma", "cameras"):
        raise InvalidInputError(f"quantity is {quoted(quantity)}; it must be 'sigma' or 'cameras'.")
    view, unit = view_area(scene, np.zeros((0, 2)), coverage.area), length_unit(scene)
    ax = axes_or_new(ax, view)
    if quantity == "sigma":
        _draw_sigma(ax, coverage, unit)
    else:
        _draw_cameras_seen(ax, coverage)
    if localization is not None:
        _draw_paths(ax, localization)
    show_ground(ax, view, unit)
    ax.tick_params(labelsize=8)
    draw_cameras(ax, scene, names_of(scene.rig, camera_names))
    return ax


def iso_levels(sigma: np.ndarray) -> np.ndarray:
    """List round numbers (1, 2, 3, 5 or 7 times a power of ten) spanning most finite values.

    Args:
        sigma: array of any shape, possibly with inf.
    """
    finite = sigma[np.isfinite(sigma) & (sigma > 0)]
    if len(finite) == 0:
        return np.zeros(0)
    low, high = np.quantile(finite, [0.01, 0.99])
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    levels = np.sort(np.outer(10.0**decades, [1, 2, 3, 5, 7]).ravel())
    levels = levels[(levels > low) & (levels < high)]
    return levels[:: max(int(np.ceil(len(levels) / ISO_LINES)), 1)]


def _draw_sigma(ax: "Axes", coverage: Coverage, unit: str) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.patheffects import withStroke

    x_min, x_max, y_min, y_max = coverage.area
    sigma = np.ma.masked_invalid(coverage.sigma)
    ax.fill_between(
        [x_min, x_max],
        y_min,
        y_max,
        facecolor="0.93",
        edgecolor="0.75",
        hatch="///",
        linewidth=0,
        zorder=0,
    )
    if not sigma.count():
        return
    low, high = (float(q) for q in np.quantile(sigma.compressed(), [0.01, 0.99]))
    norm = LogNorm(low, high if high > low else 2 * low, clip=True)
    levels, look = iso_levels(coverage.sigma), {"cmap": "viridis_r", "norm": norm}
    label, ticks = f"expected σ ({unit})", levels.tolist()
    show_map(ax, sigma, coverage.area, label, look, ticks=ticks, format="%.2g").minorticks_off()
    if len(levels) and min(sigma.shape) >= 2:
        lines = ax.contour(
            coverage.x,
            coverage.y,
            sigma,
            levels=levels.tolist(),
            colors="black",
            linewidths=0.8,
            zorder=2,
        )
        for text in ax.clabel(lines, fmt="%.2g", fontsize=8):
            text.set_path_effects([withStroke(linewidth=2, foreground="white")])


def _draw_paths(ax: "Axes", localization: Localization) -> None:
    """Draw tracks in the colors of their identities; positions without an identity as dots."""
    from matplotlib.patheffects import withStroke

    tracks = localization.tracks
    halo = [withStroke(linewidth=2.4, foreground="white")]  # the map beneath is dark
    for identity in np.unique(tracks.track_id).tolist():
        xy = tracks.ground_xy[tracks.track_id == identity]
        style = "." if identity < 0 else line_style(identity)
        color = fraction(track_color(identity))
        ax.plot(*xy.T, style, color=color, linewidth=1.2, zorder=2.5, path_effects=halo)


def _draw_cameras_seen(ax: "Axes", coverage: Coverage) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm, ListedColormap

    count = len(coverage.visible)
    shades = colormaps["cividis"](np.linspace(0.15, 1, max(count, 1)))
    colors = ListedColormap(np.vstack([[0.93, 0.93, 0.93, 1], shades]))
    norm = BoundaryNorm(np.arange(-0.5, count + 1), count + 1)
    label, look = "cameras that see the ground", {"cmap": colors, "norm": norm}
    show_map(ax, coverage.cameras, coverage.area, label, look, ticks=range(count + 1))
