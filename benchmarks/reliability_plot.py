"""Draw reliability diagrams of probabilities and of uncertainty ellipses."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from catfree.evaluation import CalibrationCurve, EllipseCoverage
from catfree.viz._palette import TRACK_COLORS, fraction, line_style
from catfree.viz.plots._axes import plain_label, require_pyplot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SMALLEST_DOT, LARGEST_DOT = 12.0, 160.0  # square points


def plot_reliability(curve: CalibrationCurve, *, ax: "Axes | None" = None) -> "Axes":
    """Draw how often stated probabilities came true, one dot per bin, larger for more samples.

    Args:
        curve: the result of `cf.evaluation.calibration_curve`.
        ax: matplotlib axes to draw on; None for a new figure.

    Returns:
        The axes, with stated probability on x and the share that came true on y.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
    """
    ax = _square(ax, "claimed probability", "share that came true")
    filled = curve.count > 0
    claimed, true = curve.mean_probability[filled], curve.observed_frequency[filled]
    count = curve.count[filled]
    ax.plot(claimed, true, color="0.6", linewidth=1, zorder=1)
    largest = float(np.log1p(count).max(initial=1.0))
    size = SMALLEST_DOT + (LARGEST_DOT - SMALLEST_DOT) * np.log1p(count) / largest
    ax.scatter(claimed, true, size, color=fraction(TRACK_COLORS[0]), zorder=2)
    for x, y, n in zip(claimed, true, count, strict=True):
        low = y > 0.85  # below the dot, to stay inside the picture
        ax.annotate(
            f"{n}",
            (x, y),
            xytext=(0, -9 if low else 9),
            textcoords="offset points",
            ha="right" if x > 0.9 else "center",
            va="top" if low else "bottom",
            fontsize=7,
            color="0.35",
        )
    ax.set_title(f"expected calibration error {curve.expected_calibration_error:.3f}", fontsize=10)
    return ax


def plot_ellipse_coverage(
    coverages: Mapping[str, EllipseCoverage], *, ax: "Axes | None" = None
) -> "Axes":
    """Draw the share of true positions inside the ellipses of each probability content.

    Args:
        coverages: results of `cf.evaluation.ellipse_coverage`, by name.
        ax: matplotlib axes to draw on; None for a new figure.

    Returns:
        The axes, with the content of the ellipse on x and the share inside on y.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
    """
    ax = _square(ax, "probability content of the ellipse", "share of true positions inside")
    for index, (name, coverage) in enumerate(coverages.items()):
        # Content of the smallest ellipse that contains each position: chi-square with two degrees
        # of freedom.
        content = np.sort(-np.expm1(-0.5 * coverage.squared_mahalanobis))
        share = np.arange(1, len(content) + 1) / max(len(content), 1)
        color = fraction(TRACK_COLORS[index % len(TRACK_COLORS)])
        ax.step(
            np.concatenate([[0.0], content, [1.0]]),
            np.concatenate([[0.0], share, [float(len(content) > 0)]]),
            where="post",
            color=color,
            linestyle=line_style(index),
            label=(
                f"{plain_label(name)}: {100 * coverage.share:.0f} % in {100 * coverage.level:g} %"
            ),
        )
    if coverages:
        ax.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5))
    return ax


def _square(ax: "Axes | None", xlabel: str, ylabel: str) -> "Axes":
    """Make axes from 0 to 1 with the diagonal of perfect calibration."""
    made: Axes = ax or require_pyplot().subplots(figsize=(5, 5), layout="constrained")[1]
    made.plot([0, 1], [0, 1], color="black", linewidth=1, linestyle=":", zorder=0)
    made.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), xlabel=xlabel, ylabel=ylabel, aspect="equal")
    return made
