"""Huber's loss by iterative reweighting, and linear regression with it and a Gaussian prior."""

import numpy as np
from jaxtyping import Float

WIDTH = 1.5  # standard deviations beyond which the loss is linear (Huber 1981)
REWEIGHTED = 3  # times; more changes little


def huber_regression(
    columns: Float[np.ndarray, "n p"],
    target: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, " p"],
    scale: float,
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Fit coefficients to rows that are divided by their standard deviations.

    Args:
        columns: (n, p) what each coefficient adds.
        target: (n,) to be explained.
        prior: (p,) standard deviations of the coefficients about zero; infinite for those that the
            rows determine.
        scale: standard deviation of the rows.

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
        fitted = ridge(huber_weight(target - columns @ fitted[0], scale))
    return fitted


def huber_weight(residual: Float[np.ndarray, "*n"], scale: float) -> Float[np.ndarray, "*n"]:
    """Weights by which least squares has the gradient of Huber's loss, 1 for small residuals."""
    return np.minimum(1, WIDTH * scale / np.maximum(np.abs(residual), 1e-12))
