"""The coefficients of the expected MODA: `python -m benchmarks.fit_reliability --write` makes them.

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
        slope: points of MODA per unit.
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
        """Compute the number that the slope multiplies: the value or its logarithm."""
        if not self.logarithm:
            return value
        return math.log(value) if value > 0 else -math.inf

    def excess(self, value: float) -> float:
        """Compute how far a transformed value is outside the fitted range; at most 0 inside."""
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


# Made by `python -m benchmarks.fit_reliability --write`; do not edit by hand.
FITS: tuple[Fit, ...] = (
    Fit(
        settings=Settings.paper(),
        intercept=-12.58,
        terms=(
            Term("detections_used", False, 127.68, 0.045, 0.738),
            Term("sigma_over_radius", True, -12.38, 0.312, 1.924),
        ),
        below=16.2,
        above=14.2,
        worlds=179,
        error=10.1,
        correlation=0.92,
    ),
    Fit(
        settings=Settings(),
        intercept=-20.47,
        terms=(
            Term("expected_recall", False, 78.80, 0.043, 0.991),
            Term("sigma_over_radius", True, -16.83, 0.146, 1.485),
            Term("mean_supporting_cameras", True, 14.07, 1.485, 5.682),
        ),
        below=23.3,
        above=23.3,
        worlds=179,
        error=14.0,
        correlation=0.81,
    ),
)
