"""Linear regression with Huber's loss and a Gaussian prior, by iterative reweighting."""

import numpy as np
from jaxtyping import Float

from catfree.geometry._arrays import MEDIAN_TO_DEVIATION

WIDTH = 1.5  # standard deviations beyond which the loss is linear (Huber 1981)
REWEIGHTED = 3  # times; more changes little


def huber_regression(
    columns: Float[np.ndarray, "n p"],
    target: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, " p"],
    scale: float | None = None,
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Fit coefficients to rows that are divided by their standard deviations.

    Args:
        columns: (n, p) what each coefficient adds; without rows, `scale` must be given.
        target: (n,) to be explained.
        prior: (p,) standard deviations of the coefficients about zero; infinite for those that the
            rows determine.
        scale: standard deviation of the rows, learned from their median residual if None.

    Returns:
        coefficients: (p,) the most likely ones.
        covariance: (p, p) of these, if rows are independent.

    Source:
        Huber, "Robust estimation of a location parameter" (1964), for the loss.
    """

    def ridge(weight: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        weighted = columns * weight[:, None]
        covariance = np.linalg.inv(weighted.T @ columns + np.diag(prior**-2.0))
        return covariance @ (weighted.T @ target), covariance

    fitted = ridge(np.ones(len(target)))
    for _ in range(REWEIGHTED):
        error = np.abs(target - columns @ fitted[0])
        usual = scale
        if usual is None:
            usual = max(MEDIAN_TO_DEVIATION * float(np.median(error)), 1e-6)
        fitted = ridge(np.minimum(1, WIDTH * usual / np.maximum(error, 1e-12)))
    return fitted
