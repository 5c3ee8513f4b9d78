"""Evidence of one joint's encoder readings alone, for many ratios of process to noise (encoder_evidence.c)."""

import ctypes

import numpy as np

from ...types import Array
from ..inference.kernel import fields, run

SKIP = 10
"""Readings after a restart that do not count, for either order: a vague start costs white jerk more."""
VAGUE = 1e8
"""Variance at a restart over a reading's: it knows nothing, and half of the digits are left."""


class _Evidence(ctypes.Structure):
    _fields_ = fields("length ratios order", "vague usual", "dt y ratio fresh counts squares logs lag")


def evidence(
    t: Array, y: Array, fresh: Array, ratios: Array, order: int = 2, known: float | None = None
) -> tuple[Array, Array, Array]:
    """Log evidence (R,) per ratio (R,) of process to noise, with the likeliest noise variance or a `known` one.

    Times t (N,) s of readings y (N,) rad, and where the filter restarts, `fresh` (N,) bool. Also the largest innovation
    (R,) of which the next one reaches a quarter, on the same side, in standard deviations: a false reading pulls the
    filter, so that the next is off to the other side; after a sudden motion it is off to the same side, by less.
    """
    dt, count = np.diff(t, prepend=t[0]), np.arange(len(t))
    fresh = np.asarray(fresh | (count == 0))
    counts = count - np.maximum.accumulate(np.where(fresh, count, 0)) >= SKIP
    squares, logs, lag = np.empty((3, len(ratios)))
    run(
        "evidence", _Evidence, length=len(t), ratios=len(ratios), order=order, vague=VAGUE,
        usual=float(np.median(dt[dt > 0.0])), dt=dt, y=np.ascontiguousarray(y), ratio=np.ascontiguousarray(ratios),
        fresh=fresh, counts=counts, squares=squares, logs=logs, lag=lag,
    )  # fmt: skip
    n = max(float(counts.sum()), 1.0)
    # a noise of 1 µrad, a twentieth of the step of a 19-bit encoder, keeps the logarithm of exact readings finite
    noise = np.maximum(squares / n if known is None else np.full(len(ratios), known), 1e-12)
    score = -0.5 * (n * np.log(noise) + squares / noise + logs)
    return np.where(np.isfinite(score), score, -np.inf), noise, lag / np.sqrt(noise)
