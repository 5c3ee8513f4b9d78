"""How far each reading is believed: a mixture of its noise and outliers that may be anywhere.

With r the residual from what the other measurements
predict, and its covariance S, the share that is believed is

    w = (1 − ε) N(r; 0, S) / ((1 − ε) N(r; 0, S) + ε / range),

and a reading weighs w of what it would. The evidence
then falls monotonically with an outlier's distance.
"""

import numpy as np

from ...types import Array

OUTLIER_SHARE = 1e-2
"""Share ε of measurements that are outliers before the log: one in a hundred, as of the filter's
FLAT_COST_NATS."""
LEAST_SHARE = 1e-6
"""Least share that counts, so that variances stay finite, and matrices of what is nearly alike keep
their inverses."""


def compute_believed_shares(residual: Array, cov: Array, span: Array) -> Array:
    """Shares (F,) of residuals (F,D) with covariances
    (F,D,D); outliers lie anywhere within span (D,).
    """
    inlier, outlier = _compute_log_mixture(residual, cov, span)
    share = 1.0 / (1.0 + np.exp(np.clip(outlier - inlier, -50.0, 50.0)))
    return np.asarray(np.maximum(share, LEAST_SHARE))


def measure_image_span(values: Array, var: Array) -> Array:
    """Within what (D,) images may lie, of seen values (F,D) with variances (F,D)."""
    return np.asarray(np.ptp(values, axis=0) + 10.0 * np.sqrt(np.median(var, axis=0)))


def compute_mixture_nats(residual: Array, cov: Array, span: Array) -> Array:
    """−ln p (F,) of residuals (F,D) with covariances (F,D,D), or of outliers within span (D,)."""
    return np.asarray(-np.logaddexp(*_compute_log_mixture(residual, cov, span)))


def _compute_log_mixture(residual: Array, cov: Array, span: Array) -> tuple[Array, float]:
    """Logarithms of (1 − ε) N(r; 0, S) (F,) and of ε / range."""
    rows = residual.shape[1]
    square = np.einsum("fd,fd->f", residual, np.linalg.solve(cov, residual[..., None])[..., 0])
    log_det = np.linalg.slogdet(cov)[1]
    inlier = -0.5 * (square + log_det + rows * np.log(2.0 * np.pi)) + np.log1p(-OUTLIER_SHARE)
    return inlier, float(np.log(OUTLIER_SHARE) - np.log(span).sum())


def compute_outlier_nats(share: Array, span: Array) -> float:
    """−ln p of measurements as far as they are outliers: believed shares (F,), span (D,)."""
    return float(((1.0 - share) * (np.log(span).sum() - np.log(OUTLIER_SHARE))).sum())


def leave_out_measurement(
    residual: Array, noise: Array, belief: Array, settled: Array
) -> tuple[Array, Array]:
    """Residuals (F,D) and covariances (F,D,D) without the measurement itself, from those with it.

    A measurement of noise R that leaves the residual r of a belief with covariance V is off the
    others' prediction by R (R − V)⁻¹ r, with covariance R (R − V)⁻¹ R (de Jong 1988).
    settled (F,D,D): covariance of r by what no measurement of the log changes any more.
    """
    rest = noise - belief
    # rounding may leave less than nothing of a measurement that the belief is made of
    floor = 1e-3 * np.einsum("fdd->fd", noise)
    np.einsum("fdd->fd", rest)[:] = np.maximum(np.einsum("fdd->fd", rest), floor)
    gain = np.linalg.solve(rest, noise).swapaxes(1, 2)
    return (gain @ residual[..., None])[..., 0], gain @ noise + gain @ settled @ gain.swapaxes(1, 2)
