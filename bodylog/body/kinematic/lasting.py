"""Slowly varying errors, such as those of a robot
that warms up or a camera mount that gives way.
"""

from dataclasses import replace

import numpy as np

from ...bfgs import minimise_with_bfgs
from ...types import Array
from ..data.subsampling import choose_spaced_rows
from ..gp.marginal_likelihood import Hyper, Spread, cholesky_with_jitter
from ..gp.model import se_kernel
from .explicit import SEARCHED, ResidualRows, evidence_derivative, solve_linear_unknowns, thin_rows

SPANS = (0.03, 0.1, 0.3)
"""Correlation times as shares of a log; of a longer one the log shows less than three."""


def fit_slow_error(
    t: Array, kernel: Hyper, data: ResidualRows
) -> tuple[Hyper, ResidualRows, float]:
    """Kernel, rows and variance (px²) with an error that
    correlates by exp(−Δt/τ) in time t (n,) s, if evident.

    τ is one of SPANS times the log's duration. The error must win what its two parameters cost
    (Schwarz 1978). The variance is averaged over τ by evidence.
    """
    whole = max(float(np.ptp(t)), 1e-9)
    rows = choose_spaced_rows(len(t), SEARCHED)
    part = thin_rows(data, SEARCHED)
    z = data.x[rows] / kernel.scales
    gram = se_kernel(z, z, 1.0)
    plain = solve_linear_unknowns(
        cholesky_with_jitter(gram * kernel.amplitude, part.spread, kernel.noise), part
    ).evidence
    gaps = np.abs(t[rows, None] - t[rows])
    found = [
        _maximise_slow_evidence(gram, np.exp(-gaps / (span * whole)), kernel, part)
        for span in SPANS
    ]
    best = int(np.argmax([one[0] for one in found]))
    worth, logs = found[best]
    if worth < plain + np.log(part.residual.size):
        return kernel, data, 0.0
    weights = np.exp([one[0] - worth for one in found])
    amplitude, noise, variance = (float(v) for v in np.exp(logs))
    spread = _add_slow_error(data.spread, t, SPANS[best] * whole, variance)
    mean = float(weights @ [np.exp(one[1][2]) for one in found] / weights.sum())
    return replace(kernel, amplitude=amplitude, noise=noise), replace(data, spread=spread), mean


def _maximise_slow_evidence(
    gram: Array, like: Array, kernel: Hyper, data: ResidualRows
) -> tuple[float, Array]:
    """Evidence (nats) and the logarithms of amplitude, noise and slow variance at its maximum."""

    def loss(logs: Array) -> tuple[float, Array]:
        amplitude, noise, variance = np.exp(logs)
        chol = cholesky_with_jitter(gram * amplitude + variance * like, data.spread, noise)
        found = solve_linear_unknowns(chol, data)
        worth = evidence_derivative(chol, found)
        slopes = [
            amplitude * (worth * gram).sum(),
            noise * np.trace(worth),
            variance * (worth * like).sum(),
        ]
        return -found.evidence, -0.5 * np.array(slopes)

    first = np.log([kernel.amplitude, 0.7 * kernel.noise, 0.3 * kernel.noise])
    found = minimise_with_bfgs(loss, first, first - 6.0, first + 4.0, np.eye(3) * len(gram))
    return -found.loss, found.at


def _add_slow_error(known: Spread, t: Array, span: float, variance: float) -> Spread:
    """Add the slow error to the known noise."""
    i, j = np.nonzero(np.tril(np.ones((len(t), len(t))), -1))
    value = np.concatenate([known.value, variance * np.exp(-np.abs(t[i] - t[j]) / span)])
    places = np.concatenate([known.i, i]) * len(t) + np.concatenate([known.j, j])
    place, into = np.unique(places, return_inverse=True)
    value = np.bincount(into, value, minlength=len(place))
    return Spread(known.diagonal + variance, place // len(t), place % len(t), value, known.share)
