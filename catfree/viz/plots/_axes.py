"""Axes of the plots; matplotlib is optional and imported only when a plot is drawn."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Num

from catfree.errors import InvalidInputError, needing, shortened

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure

LONGER_SIDE = 7.5  # inches
LEGEND = 1.2  # inches for legend and labels, beside and below


def require_pyplot() -> Any:
    """Import `matplotlib.pyplot`.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
    """
    with needing("Plots need matplotlib: pip install 'catfree[plot]'."):
        import matplotlib.pyplot as pyplot
    return pyplot


def axes_or_new(ax: "Axes | None", view: tuple[float, float, float, float]) -> "Axes":
    """Return the given axes, or those of a new figure.

    Args:
        ax: axes to draw on, or None.
        view: x_min, x_max, y_min, y_max to show with equal axis scales; sets the shape of a new
            figure.
    """
    pyplot = require_pyplot()
    if ax is not None:
        return ax
    width, height = view[1] - view[0], view[3] - view[2]
    scale = LONGER_SIDE / max(width, height)
    narrowest = 0.65 * LONGER_SIDE
    size = (max(width * scale, narrowest) + LEGEND, max(height * scale, 0.4 * LONGER_SIDE) + LEGEND)
    return pyplot.subplots(figsize=size, layout="constrained")[1]


def show_ground(ax: "Axes", view: tuple[float, float, float, float], unit: str) -> None:
    """Show a rectangle of the ground with equal scales, and label its axes.

    Args:
        ax: the axes.
        view: x_min, x_max, y_min, y_max in ground coordinates.
        unit: unit of the ground coordinates.
    """
    ax.set(xlim=view[:2], ylim=view[2:], aspect="equal")
    ax.set(xlabel=f"ground x ({unit})", ylabel=f"ground y ({unit})")


def show_map(
    ax: "Axes",
    values: Num[np.ndarray, "height width"],
    area: tuple[float, float, float, float],
    label: str,
    look: dict[str, Any],
    **bar: Any,
) -> "Colorbar":
    """Draw values of equal cells of the ground, with a color bar.

    Args:
        ax: the axes.
        values: (H, W), rows in ascending y.
        area: x_min, x_max, y_min, y_max of the outer edges of the cells.
        label: label of the color bar.
        look: colors of the values, as `Axes.imshow` takes them.
        **bar: ticks and format of the color bar.
    """
    image = ax.imshow(
        values, extent=area, origin="lower", interpolation="nearest", zorder=1, **look
    )
    return figure_of(ax).colorbar(image, ax=ax, label=label, shrink=0.8, **bar)


def plain_label(text: str) -> str:
    """Escape a name for matplotlib: no formula between dollars, no missing glyph.

    Letters that the fonts of `rcParams` lack become question marks, as OpenCV draws them.
    """
    from matplotlib.font_manager import FontProperties, findfont, get_font

    families = FontProperties().get_family()
    fonts = [get_font(findfont(FontProperties(family=[family]))) for family in families]

    def drawable(letter: str) -> bool:
        return letter.isprintable() and any(font.get_char_index(ord(letter)) for font in fonts)

    plain = "".join(letter if drawable(letter) else "?" for letter in shortened(text))
    return plain.replace("$", r"\$")


def figure_of(ax: "Axes") -> "Figure":
    """Return the top-level figure of axes, also of axes inside a sub-figure.

    Raises:
        InvalidInputError: if the axes were removed from their figure.
    """
    figure = ax.get_figure(root=True)
    if figure is None:
        raise InvalidInputError("The given axes were removed from their figure: pass new ones.")
    return figure
