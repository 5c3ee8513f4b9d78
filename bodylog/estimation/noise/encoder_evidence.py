"""Evidence of encoder readings alone, for many ratios of process to noise: all stretches are filtered in parallel.

Arrays are (M,C,R), joints M, stretches C, ratios R, so that NumPy passes through long rows. Joints whose readings have
equal times share their covariances.
"""

from collections.abc import Iterator

import numpy as np

from ...types import Array
from ..inference.motion import carry, grow

SKIP = 10
"""Readings after a restart that do not count, for either order: a vague start costs white jerk more."""


def evidence(
    dt: Array, y: Array, fresh: Array, ratios: Array, order: int = 2, known: Array | None = None
) -> tuple[Array, Array, Array]:
    """Log evidence (R,M) per ratio process/noise (R,M), with the likeliest noise variance or a `known` (M,).

    Time steps dt (L,M,C) s · readings y (L,M,C) rad, NaN where absent · restarts `fresh` (L,M,C) bool. The first half
    of every stretch but the first only warms the filter up. Also the largest innovation (R,M) of which the next one
    reaches a quarter, on the same side, in standard deviations.
    """
    read, count = np.isfinite(y), np.arange(len(y))[:, None, None]
    fresh = np.asarray(fresh | (count == 0))
    counts = np.asarray(read & (count - np.maximum.accumulate(np.where(fresh, count, 0)) >= SKIP))
    counts[: len(y) // 2, :, 1:] = False
    # readings with equal times and ratios have the same covariance, which is computed once
    first, which = _same_covariance(dt, read, fresh, ratios)
    gains = _gains(dt[:, first], counts[:, first], fresh[:, first], ratios[:, first].T, order)
    squares, logs, lag = (part.T for part in _sums(dt, y, fresh, gains, which, (order, len(ratios))))
    n = np.maximum(counts.sum(axis=(0, 2)), 1.0)
    # a noise of 1 µrad, a twentieth of the step of a 19-bit encoder, keeps the logarithm of exact readings finite
    noise = np.maximum(squares / n if known is None else np.broadcast_to(known, squares.shape), 1e-12)
    score = -0.5 * (n * np.log(noise) + squares / noise + logs)
    return np.where(np.isfinite(score), score, -np.inf), noise, lag / np.sqrt(noise)


def _sums(
    dt: Array, y: Array, fresh: Array, gains: Iterator[tuple[Array, Array, Array]], which: Array | slice,
    shape: tuple[int, int],
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Sums (M,R) of squared innovations over their variances and of log variances; the largest that lags.

    A reading that is false pulls the filter, so that the next is off to the other side. After a sudden motion the next
    one is off to the same side, by less: a quarter tells it from noise.
    `gains` as in `_gains`, by group of joints; `which` (M,): the group of each joint · shape: states and ratios.
    """
    x, y = np.zeros((shape[0], *y.shape[1:], shape[1])), np.where(np.isfinite(y), y, 0.0)[..., None]
    squares, nu, lag, lead, more, wide = np.zeros((6, *x.shape[1:]))
    logs, recent = np.zeros(()), np.zeros((2, *squares.shape))
    begins: Array = np.any(fresh, axis=(1, 2))
    for i, (gain, weight, log) in enumerate(gains):
        carry(x, dt[i, ..., None])
        if begins[i]:
            x[:, fresh[i]] = 0.0
            x[0, fresh[i]] = y[i, fresh[i]]
        np.subtract(y[i], x[0], out=nu)
        off, before = recent[i % 2], recent[i % 2 - 1]
        np.multiply(nu, weight[which], out=off)
        squares += np.multiply(off, off, out=more)
        logs = np.asarray(logs + log)
        np.multiply(off, 4.0, out=wide)
        np.maximum(lag, np.minimum(wide, before, out=more), out=lag)
        np.minimum(lead, np.maximum(wide, before, out=more), out=lead)
        for state, share in zip(x, gain, strict=True):
            np.multiply(share[which], nu, out=more)
            state += more
    return squares.sum(axis=1), logs.sum(axis=1)[which], np.maximum(lag, -lead).max(axis=1)


def _gains(
    dt: Array, counts: Array, fresh: Array, ratios: Array, order: int
) -> Iterator[tuple[Array, Array, Array]]:  # fmt: skip
    """Yield each step's gain (S,U,C,R), 1 over its deviation and its log variance (U,C,R), 0 where it does not count.

    ratios (U,R) of process to noise; covariances are in units of the noise.
    """
    p, grown = np.zeros((2, order, order, *dt.shape[1:], ratios.shape[1]))
    spread, vague = np.zeros((len(dt), order, order, *dt.shape[1:], 1)), np.zeros((order, order, *dt.shape[1:], 1))
    grow(np.moveaxis(spread, 0, 2), order, 1.0, dt[..., None])
    usual = np.array([np.median(own[own > 0]) for own in dt.swapaxes(0, 1)])[:, None, None]
    for state in range(order):
        # so vague that a restart knows nothing, and half of the digits are left
        vague[state, state] = 1e8 / usual ** (2 * state)
    begins, whole = np.any(fresh, axis=(1, 2)), np.all(counts, axis=(1, 2))
    for i, h in enumerate(dt[..., None]):
        carry(p, h)
        carry(p.swapaxes(0, 1), h)
        p += np.multiply(spread[i], ratios[:, None], out=grown)
        if begins[i]:
            p[:, :, fresh[i]] = vague[:, :, fresh[i]]
        s = p[0, 0] + 1.0
        gain = p[0] / s
        p[1:, 1:] -= gain[1:, None] * p[0, 1:]
        p[0] = p[:, 0] = gain
        p[-1, 1:] = p[1:, -1]  # rounding makes it unsymmetric, which grows until variances are negative
        weight, log = 1.0 / np.sqrt(s), np.log(s)
        if not whole[i]:
            weight *= counts[i, ..., None]
            log *= counts[i, ..., None]
        yield gain, weight, log


def _same_covariance(*parts: Array) -> tuple[Array, Array | slice]:
    """First column (U,) of each group that is equal in all parts (L,M,…), and each column's group (M,)."""
    keys = [b"".join(part[:, column].tobytes() for part in parts) for column in range(parts[0].shape[1])]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    first = np.array([keys.index(key) for key in numbers])
    return first, slice(None) if len(first) == 1 else np.array([numbers[key] for key in keys])
