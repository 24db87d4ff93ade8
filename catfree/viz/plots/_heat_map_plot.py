"""Picture of a heat map."""

from typing import TYPE_CHECKING

import numpy as np

from catfree.types._validation import require_instance
from catfree.viz._heat_map import HeatMap
from catfree.viz.plots._axes import axes_or_new, show_ground, show_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_heat_map(heat: HeatMap, *, ax: "Axes | None" = None, unit: str = "m") -> "Axes":
    """Draw the numbers of positions over the ground; cells with too few people stay blank.

    Args:
        heat: the result of `heat_map`.
        ax: matplotlib axes to draw on; None for a new figure.
        unit: unit of the ground coordinates, for the labels.

    Returns:
        The axes, in ground coordinates.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
    """
    require_instance(heat, HeatMap, "heat")
    half = heat.cell / 2
    view = (-half, half, -half, half)
    if heat.positions.size:
        (left, right), (low, high) = heat.x[[0, -1]].tolist(), heat.y[[0, -1]].tolist()
        view = (left - half, right + half, low - half, high + half)
    ax = axes_or_new(ax, view)
    if heat.positions.size:
        label = f"positions, cells with at least {heat.k} people"
        values = np.ma.masked_invalid(heat.positions)
        show_map(ax, values, view, label, {"cmap": "viridis", "vmin": 0})
    show_ground(ax, view, unit)
    return ax
