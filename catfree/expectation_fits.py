"""The coefficients of the expected MODA: `python benchmarks/fit_reliability.py --write` makes them.

Fitted to simulated worlds alone (`benchmarks/reliability_worlds.py`); no real recording took part.
"""

import math
from dataclasses import dataclass

from catfree.settings import Settings
from catfree.types import Reliability


@dataclass(frozen=True)
class Term:
    """One number of `Reliability` in the linear function.

    Attributes:
        name: field of `Reliability`.
        logarithm: whether its natural logarithm is taken.
        slope: points of MODA a unit.
        low: smallest value in the fit, before the logarithm.
        high: largest one.
    """

    name: str
    logarithm: bool
    slope: float
    low: float
    high: float

    def read(self, reliability: Reliability) -> float:
        """The value in a result, before the logarithm; NaN where it has none."""
        value = getattr(reliability, self.name)
        return math.nan if value is None else float(value)

    def transform(self, value: float) -> float:
        """What is multiplied by the slope."""
        if not self.logarithm:
            return value
        return math.log(value) if value > 0 else -math.inf

    def excess(self, value: float) -> float:
        """How far a value lies outside the fitted range, transformed; not above 0 within."""
        at = self.transform(value)
        return max(at - self.transform(self.high), self.transform(self.low) - at)


@dataclass(frozen=True)
class Fit:
    """The expected MODA of one method.

    Attributes:
        settings: what the method ran with.
        intercept: in points of MODA.
        terms: what is added to it.
        below: how far MODA falls short of the expectation at worst, 5 % of the worlds left out.
        above: how far it exceeds it at most, 5 % left out.
        worlds: number of simulated worlds.
        error: root mean square error in points on worlds held out of the fit.
        correlation: Pearson correlation of expectation and MODA there.
    """

    settings: Settings
    intercept: float
    terms: tuple[Term, ...]
    below: float
    above: float
    worlds: int
    error: float
    correlation: float


# Made by `python benchmarks/fit_reliability.py --write`; do not edit by hand.
FITS: tuple[Fit, ...] = (
    Fit(
        settings=Settings.paper(),
        intercept=-11.78,
        terms=(
            Term("detections_used", False, 125.95, 0.046, 0.738),
            Term("sigma_over_radius", True, -11.21, 0.313, 1.924),
        ),
        below=18.0,
        above=15.4,
        worlds=138,
        error=10.4,
        correlation=0.92,
    ),
)
