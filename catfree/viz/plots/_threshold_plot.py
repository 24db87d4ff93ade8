"""Histograms of the two statistics that Otsu's method splits, with the estimated thresholds."""

from typing import TYPE_CHECKING

import numpy as np

from catfree.settings import SelectionSettings
from catfree.types import Candidates, Fate, Localization, Scene
from catfree.types._scene import require_scene
from catfree.types._validation import as_positive, require_instance
from catfree.viz._palette import FATE_COLORS, fraction
from catfree.viz.plots._axes import require_pyplot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BINS = 60
# The first bin collects this share of the smallest values: single candidates that lie almost
# exactly on the ground would stretch the logarithmic axis over many decades.
TAIL = 0.002


def plot_gates(
    localization: Localization,
    scene: Scene,
    *,
    axes: "tuple[Axes, Axes] | None" = None,
    suppression_radius: float = SelectionSettings().suppression_radius,
) -> "tuple[Axes, Axes]":
    """Draw the histograms of sigma and of g with the thresholds estimated from them.

    Left: sigma of all candidates that pass the angular gate. Right: g of those among them whose
    sigma is at most its threshold. Both in units of the suppression radius, on a logarithmic axis,
    colored by the fate of the candidates. The accepted range is shaded; a dotted line is the
    threshold that the recovery estimated from the remaining candidates.

    Args:
        localization: the result of `cf.localize`.
        scene: the scene it was computed with.
        axes: two matplotlib axes to draw on; None for a new figure.
        suppression_radius: r as a share of E.

    Returns:
        The two axes.

    Raises:
        MissingDependencyError: if matplotlib is not installed.
        InvalidInputError: if an argument has another type, or the radius is not positive.

    Source: paper, Fig. gates.
    """
    require_instance(localization, Localization, "localization")
    require_scene(scene)
    pyplot = require_pyplot()
    if axes is None:
        both = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained")[1]
        axes = both[0], both[1]
    radius = as_positive(suppression_radius, "suppression_radius") * float(scene.extent)
    thresholds, (left, right) = localization.thresholds, axes
    sigma_values, ground_values = gate_samples(localization)
    candidates = localization.candidates
    _histogram(left, candidates, sigma_values, candidates.sigma / radius)
    _histogram(right, candidates, ground_values, candidates.ground_distance / radius)
    _threshold(left, r"\tau_\sigma", thresholds.tau_sigma, thresholds.tau_sigma_recovery, radius)
    _threshold(right, r"\tau_g", thresholds.tau_g, thresholds.tau_g_recovery, radius)
    left.set(xlabel="1. uncertainty σ / suppression radius", ylabel="candidates")
    right.set(xlabel="2. distance to the ground g / suppression radius", ylabel="candidates")
    return axes


def gate_samples(localization: Localization) -> tuple[np.ndarray, np.ndarray]:
    """Select the candidates (H,) of each of the two histograms.

    First: those that passed the angular gate and have a finite sigma. Second: those of the first
    whose sigma is at most its threshold (all of them if there is no threshold).
    """
    candidates, limit = localization.candidates, localization.thresholds.tau_sigma
    first = (candidates.fate != Fate.RMS_GATE) & np.isfinite(candidates.sigma)
    # The threshold lies midway between two values, so float32 rounding does not matter.
    second = first if limit is None else first & (candidates.sigma <= limit)
    return first, second


def _histogram(ax: "Axes", candidates: Candidates, chosen: np.ndarray, values: np.ndarray) -> None:
    """Draw a histogram stacked by fate on a logarithmic axis."""
    ax.set_xscale("log")
    ax.tick_params(labelsize=8)
    positive = values[chosen & (values > 0)]
    if len(positive) == 0:
        ax.text(0.5, 0.5, "no candidates", transform=ax.transAxes, ha="center", color="0.4")
        return
    low, high = np.quantile(positive, TAIL), positive.max()
    low, high = (low, high) if low < high else (low / 2, high * 2)
    edges = np.geomspace(low, high * (1 + 1e-9), BINS + 1)
    fates = [fate for fate in FATE_COLORS if (candidates.fate[chosen] == fate).any()]
    ax.hist(
        [np.clip(values[chosen & (candidates.fate == fate)], low, high) for fate in fates],
        bins=edges.tolist(),
        stacked=True,
        color=[fraction(FATE_COLORS[fate]) for fate in fates],
        label=[fate.name.lower().replace("_", " ") for fate in fates],
    )
    ax.set_xlim(float(edges[0]), float(edges[-1]))
    ax.set_ylim(0, 1.15 * ax.get_ylim()[1])  # room for the threshold's name above the bars
    ax.legend(fontsize=8, frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _threshold(
    ax: "Axes", symbol: str, value: float | None, again: float | None, radius: float
) -> None:
    low, high = ax.get_xlim()
    for threshold, style in ((value, "-"), (again, ":")):
        if threshold is not None and threshold > 0:
            low, high = min(low, 0.8 * threshold / radius), max(high, 1.25 * threshold / radius)
            ax.axvline(threshold / radius, color="black", linestyle=style, linewidth=1.4)
    ax.set_xlim(low, high)
    if value is not None and value > 0:
        ax.axvspan(low, value / radius, color="0.5", alpha=0.13, linewidth=0, zorder=0)
        place = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        text = f"${symbol}$ = {value / radius:.2g} r"
        beside = (6, -6) if value / radius < np.sqrt(low * high) else (-6, -6)
        side = "left" if beside[0] > 0 else "right"
        ax.annotate(
            text,
            (value / radius, 0.96),
            xytext=beside,
            ha=side,
            fontsize=9,
            **place,
            bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.5},
        )
