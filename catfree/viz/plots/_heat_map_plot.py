"""Picture of a heat map."""

from typing import TYPE_CHECKING

import numpy as np

from catfree.viz._heat_map import HeatMap
from catfree.viz.plots._axes import axes_or_new, figure_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_heat_map(heat: HeatMap, *, ax: "Axes | None" = None, unit: str = "m") -> "Axes":
    """Draw the numbers of positions over the ground; cells with too few people stay blank.

    Args:
        heat: the result of `heat_map`.
        ax: matplotlib axes to draw on; None for a new figure.
        unit: of the ground coordinates, for the labels.

    Returns:
        The axes, in ground coordinates.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
    """
    half = heat.cell / 2
    if heat.positions.size:
        area = (heat.x[0] - half, heat.x[-1] + half, heat.y[0] - half, heat.y[-1] + half)
    else:
        area = (-half, half, -half, half)
    view = tuple(float(side) for side in area)
    ax = axes_or_new(ax, (view[0], view[1], view[2], view[3]))
    if heat.positions.size:
        image = ax.imshow(
            np.ma.masked_invalid(heat.positions),
            extent=(view[0], view[1], view[2], view[3]),
            origin="lower",
            cmap="viridis",
            interpolation="nearest",
            vmin=0,
        )
        text = f"positions, cells with at least {heat.k} people"
        figure_of(ax).colorbar(image, ax=ax, label=text, shrink=0.8)
    ax.set(xlim=view[:2], ylim=view[2:], aspect="equal")
    ax.set(xlabel=f"ground x ({unit})", ylabel=f"ground y ({unit})")
    return ax
