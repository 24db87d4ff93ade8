"""The MODA to expect of a run, from what it says about itself: no labels, no truth.

A linear function of scale-free numbers of `Reliability`, one a method, fitted to simulated worlds
whose truth is known (`_expectation_fits`; `python -m benchmarks.fit_reliability` makes them
again). For the paper's method they are the share of the boxes that end up in a position and the
median sigma; sigma alone, taken where positions are reported, says little, because those that are
reported are those with a small sigma. For the evidence method they are the recall that its own
probabilities of existence promise, the median sigma and the cameras a position.

It holds for

- the settings it was fitted with, `Settings.paper()` and `Settings()`, at half a metre,
- an area that the cameras were put up to watch, and boxes of people of any quality between those
  of the fit: what no box shows, a label-free number cannot know,
- errors that differ between cameras. One that all cameras share (a wrong scale, a ground that is
  too high) moves everybody alike and is invisible from within.

Somewhat outside of the fitted range of a number the function is continued and the interval widened
by as much as the continuation changed it; far outside nothing is said: NaN. Both leave a note.
"""

import dataclasses
import math
from collections.abc import Sequence

from catfree.methods._expectation_fits import FITS, Fit
from catfree.settings import Settings
from catfree.types import Localization, Reliability

FARTHEST = 0.5  # share of a fitted range by which a number may lie outside it


def with_expectation(result: Localization, settings: Settings) -> Localization:
    """The result with the MODA to expect in its `reliability`.

    Args:
        result: what a method found.
        settings: what it ran with.

    Returns:
        The same result, `expected_moda`, `moda_low`, `moda_high` and `expectation_note` filled in.
    """
    reliability = expect_moda(result.reliability, settings, positions=len(result.tracks))
    return dataclasses.replace(result, reliability=reliability)


def expect_moda(
    reliability: Reliability,
    settings: Settings,
    *,
    positions: int | None = None,
    fits: Sequence[Fit] = FITS,
) -> Reliability:
    """The summary with the MODA to expect.

    Args:
        reliability: the other numbers of the summary.
        settings: what the run used; the calibration's do not matter.
        positions: how many were reported, where that is known. None reported is a MODA of 0,
            whatever else holds, if there was anybody.
        fits: the coefficients; those of the library by default.

    Returns:
        The summary with the four fields filled in.
    """
    if positions == 0:
        return _said(reliability, 0.0, 0.0, 0.0, "No position was reported.")
    fit = next((fit for fit in fits if _same_method(fit.settings, settings)), None)
    if fit is None:
        known = " and ".join(
            "Settings.paper()" if fit.settings.method == "paper" else "Settings()" for fit in fits
        )
        changed = ", ".join(_differences(fits, settings))
        return _unsaid(
            reliability,
            f"The expectation was fitted for {known}; these settings differ in {changed}, on which "
            "it depends.",
        )
    total, beyond, note = fit.intercept, 0.0, None
    for term in fit.terms:
        value = term.read(reliability)
        excess = term.excess(value)
        if not excess <= 0:  # NaN too
            note = (
                f"{term.name.replace('_', ' ')} is {value:.3g}; the expectation is known between "
                f"{term.low:.3g} and {term.high:.3g}."
            )
            if not excess <= FARTHEST * (term.transform(term.high) - term.transform(term.low)):
                return _unsaid(reliability, note)
            beyond += abs(term.slope) * excess
        total += term.slope * term.transform(value)
    middle = min(total, 100.0)
    low = min(total - fit.below - beyond, middle)
    high = min(total + fit.above + beyond, 100.0)
    return _said(reliability, middle, low, high, note)


def _said(
    reliability: Reliability, middle: float, low: float, high: float, note: str | None
) -> Reliability:
    return dataclasses.replace(
        reliability, expected_moda=middle, moda_low=low, moda_high=high, expectation_note=note
    )


def _unsaid(reliability: Reliability, note: str) -> Reliability:
    return _said(reliability, math.nan, math.nan, math.nan, note)


def _same_method(fitted: Settings, used: Settings) -> bool:
    """Whether two settings localize alike: only the parts that the method reads are compared."""
    return not _changed_parts(fitted, used)


def _changed_parts(fitted: Settings, used: Settings) -> list[str]:
    parts = ["method", "confidence", "rays"]
    if used.method == "evidence":
        parts += ["evidence"]
    else:
        parts += ["tracklets", "association", "triangulation", "selection", "trajectories"]
    return [part for part in parts if getattr(fitted, part) != getattr(used, part)]


def _differences(fits: Sequence[Fit], used: Settings) -> list[str]:
    """The settings, by name, that differ from those of the fit of the same method."""
    fitted = next((fit.settings for fit in fits if fit.settings.method == used.method), None)
    if fitted is None:
        return ["method"]
    names = []
    for part in _changed_parts(fitted, used):
        one, other = getattr(fitted, part), getattr(used, part)
        if not dataclasses.is_dataclass(one):
            names.append(part)
            continue
        fields = (field.name for field in dataclasses.fields(one))
        names += [f"{part}.{n}" for n in fields if getattr(one, n) != getattr(other, n)]
    return names
