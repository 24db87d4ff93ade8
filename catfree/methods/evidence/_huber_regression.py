"""Linear regression with Huber's loss, by iterative reweighting, and a Gaussian prior."""

import numpy as np
from jaxtyping import Float

WIDTH = 1.5  # standard deviations beyond which the loss is linear (Huber 1981)
REWEIGHTED = 3  # iterations; more change little


def huber_regression(
    columns: Float[np.ndarray, "n p"],
    target: Float[np.ndarray, " n"],
    prior: Float[np.ndarray, " p"],
    scale: float,
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Fit coefficients to whitened rows.

    Args:
        columns: (n, p) design matrix.
        target: (n,) observations.
        prior: (p,) standard deviations of the coefficients about zero; infinite for no prior.
        scale: standard deviation of the rows.

    Returns:
        coefficients: (p,) most likely values.
        covariance: (p, p) covariance of the coefficients, if rows are independent.

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
    """Weights that give least squares the gradient of Huber's loss; 1 for small residuals."""
    return np.minimum(1, WIDTH * scale / np.maximum(np.abs(residual), 1e-12))
