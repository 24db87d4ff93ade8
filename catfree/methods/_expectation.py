"""Predict the MODA of a run from its label-free reliability summary.

The prediction is a linear function of scale-free numbers of `Reliability`, one function per method,
fitted to simulated worlds with known truth (`_expectation_fits`, computed by
`python -m benchmarks.fit_reliability`). For the paper's method the numbers are the share of boxes
used by a position and the median sigma; sigma alone is a weak predictor because only positions with
a small sigma are reported. For the evidence method they are the recall expected from its existence
probabilities, the median sigma and the number of cameras per position.

It is valid for

- the settings it was fitted with, `Settings.paper()` and `Settings()`, at half a meter,
- an area that the cameras are set up to watch, and boxes of a quality within the range of the fit:
  a label-free number cannot account for people without any box,
- errors that differ between cameras. An error that all cameras share (a wrong scale, a ground that
  is too high) shifts all positions and cannot be detected without labels.

At most half is expected, with a note, if the residuals of a camera show a wrong lens, if they show
a clock error or a camera movement that displaces people by half the radius within which a position
counts, if two cameras do not see the same people, or if two standard deviations of cameras from
people exceed that radius.

Slightly outside the fitted range of a number the function is extrapolated, and the interval widened
by the change due to the extrapolation. Far outside the result is NaN. Both cases add a note.
"""

import dataclasses
import math
from collections.abc import Sequence

from catfree.methods._expectation_fits import FITS, Fit
from catfree.methods.evidence.report._lens_pattern import NOTICEABLE
from catfree.methods.evidence.report._residual_patterns import LEAST_TOGETHER
from catfree.settings import Settings
from catfree.types import Localization, Reliability

DOUBTED = 50.0  # percent: the most that is expected of cameras that the boxes contradict
SURE = (
    2.0  # so many standard deviations of the cameras, or shifts of people, must fit in the radius
)
FARTHEST = 0.5  # share of a fitted range by which a number may exceed it


def with_expectation(result: Localization, settings: Settings) -> Localization:
    """Add the expected MODA to the `reliability` of a result.

    Args:
        result: the result of a method.
        settings: the settings of the run.

    Returns:
        The same result with `expected_moda`, `moda_low`, `moda_high` and `expectation_note` set.
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
    """Add the expected MODA to a reliability summary.

    Args:
        reliability: the summary.
        settings: of the run; those of the calibration have no effect.
        positions: number of reported positions, if known. With 0 the MODA is 0, provided that
            there was anybody.
        fits: the coefficients; those of the library by default.

    Returns:
        The summary with the four fields set.
    """
    if positions == 0:
        return _with_moda(reliability, 0.0, 0.0, 0.0, "No position was reported.")
    fit = next((fit for fit in fits if not _changed_parts(fit.settings, settings)), None)
    if fit is None:
        fitted = " or ".join(
            "Settings.paper()" if fit.settings.method == "paper" else "Settings()" for fit in fits
        )
        changed = ", ".join(_differences(fits, settings))
        return _without_moda(
            reliability,
            f"It can be predicted only for runs with {fitted}, and this one has {changed}.",
        )
    total, widening, note = fit.intercept, 0.0, None
    for term in fit.terms:
        value = term.read(reliability)
        excess = term.excess(value)
        if not excess <= 0:  # NaN too
            note = (
                f"{term.name.replace('_', ' ')} is {value:.3g}; the expectation was fitted between "
                f"{term.low:.3g} and {term.high:.3g}."
            )
            if not excess <= FARTHEST * (term.transform(term.high) - term.transform(term.low)):
                return _without_moda(reliability, note)
            widening += abs(term.slope) * excess
        total += term.slope * term.transform(value)
    middle = min(total, 100.0)
    low = min(total - fit.below - widening, middle)
    high = min(total + fit.above + widening, 100.0)
    doubt = _doubt(reliability)
    if doubt is not None:
        middle, low, note = min(middle, DOUBTED), min(low, 0.0), doubt
    return _with_moda(reliability, middle, low, high, note)


def _doubt(reliability: Reliability) -> str | None:
    """Say why the cameras may be wrong: the boxes contradict them, or few people placed them."""
    bend, shift = reliability.lens_bend, reliability.shift_over_radius
    together, deviation = reliability.least_together, reliability.rig_sd_over_radius
    if (
        (bend is not None and bend > NOTICEABLE)
        or (shift is not None and SURE * shift > 1)
        or (together is not None and together < LEAST_TOGETHER)
    ):
        return "The boxes contradict the cameras; the warnings of the result say how."
    if deviation is not None and SURE * deviation > 1:
        return (
            "Too few people were seen to place the cameras reliably: their standard deviation is "
            f"{deviation:.2g} times the radius within which a position is right. Record longer."
        )
    return None


def _with_moda(
    reliability: Reliability, middle: float, low: float, high: float, note: str | None
) -> Reliability:
    return dataclasses.replace(
        reliability, expected_moda=middle, moda_low=low, moda_high=high, expectation_note=note
    )


def _without_moda(reliability: Reliability, note: str) -> Reliability:
    return _with_moda(reliability, math.nan, math.nan, math.nan, note)


def _changed_parts(fitted: Settings, used: Settings) -> list[str]:
    """Parts that the method of `used` reads, and that differ."""
    parts = ["method", "confidence", "rays"]
    if used.method == "evidence":
        parts += ["evidence"]
    else:
        parts += ["tracklets", "association", "triangulation", "selection", "trajectories"]
    return [part for part in parts if getattr(fitted, part) != getattr(used, part)]


def _differences(fits: Sequence[Fit], used: Settings) -> list[str]:
    """Settings, with their values, that differ from those of the fit of the same method."""
    fitted = next((fit.settings for fit in fits if fit.settings.method == used.method), None)
    if fitted is None:
        return [f"method={used.method!r}"]
    changed = []
    for part in _changed_parts(fitted, used):
        one, other = getattr(fitted, part), getattr(used, part)
        if not dataclasses.is_dataclass(one):
            changed.append(f"{part}={other!r}")
            continue
        names = (field.name for field in dataclasses.fields(one))
        changed += [
            f"{part}.{name}={getattr(other, name)!r}"
            for name in names
            if getattr(one, name) != getattr(other, name)
        ]
    return changed
