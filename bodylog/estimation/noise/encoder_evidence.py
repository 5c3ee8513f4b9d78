"""Evidence of encoder readings alone, for many ratios of process to noise: all stretches are filtered in parallel.

Arrays are (M,C,R), joints M, stretches C, ratios R, so that NumPy passes through long rows. Joints whose readings have
equal times share their covariances.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...types import Array
from ..inference.motion import carry, grow

VAGUE = 1e8
"""Noise variances: initial variance of a filter."""
SKIP = 10
"""Readings after a restart that do not count."""
WARM = 128
"""Readings of the stretch before with which each stretch starts, and which do not count, so that no stretch starts from
a vague belief: that would count against white jerk, which takes longer to settle. On 30 drawn logs of fast, slow and
quiet motion the orders and errors are those of one whole stretch; with 64 they are not yet."""
LEAST = 1e-12
"""rad²: least encoder variance, (1 µrad)², a twentieth of the step of a 19-bit encoder."""


@dataclass(frozen=True, eq=False)
class _Steps:
    """Time steps dt (L,M,C) s · known, counts, fresh (L,M,C) bool: readings, those that count, restarts."""

    dt: Array
    known: Array
    counts: Array
    fresh: Array

    def of(self, joints: Array) -> "_Steps":
        """The steps of some joints."""
        return _Steps(*(part[:, joints] for part in (self.dt, self.known, self.counts, self.fresh)))


def evidence(
    dt: Array, y: Array, fresh: Array, ratios: Array, order: int = 2, known: Array | None = None
) -> tuple[Array, Array, Array]:
    """Log evidence (R,M) per ratio process/noise (R,M), with the likeliest noise variance or a `known` (M,).

    Time steps dt (L,M,C) s · readings y (L,M,C) rad, NaN where absent · restarts `fresh` (L,M,C) bool. The first
    WARM readings of all stretches but the first do not count. Also the largest innovation (R,M) of which the next one
    reaches a quarter, on the same side, in standard deviations.
    """
    read, count = np.isfinite(y), np.arange(len(y))[:, None, None]
    fresh = np.asarray(fresh | (count == 0))
    counts = np.asarray(read & (count - np.maximum.accumulate(np.where(fresh, count, 0)) >= SKIP))
    counts[:WARM, :, 1:] = False
    steps = _Steps(dt, read, counts, fresh)
    # readings with equal times and ratios have the same covariance, which is computed once
    first, which = _same_covariance(dt, read, fresh, ratios)
    gains = _gains(steps.of(first), np.ascontiguousarray(ratios[:, first].T), order)
    squares, logs, lag = (part.T for part in _sums(steps, y, gains, which, len(ratios), order))
    n = np.maximum(counts.sum(axis=(0, 2)), 1.0)
    noise = np.maximum(squares / n if known is None else np.broadcast_to(known, squares.shape), LEAST)
    score = -0.5 * (n * np.log(noise) + squares / noise + logs)
    return np.where(np.isfinite(score), score, -np.inf), noise, lag / np.sqrt(noise)


def _sums(
    steps: _Steps, y: Array, gains: Iterator[tuple[Array, Array, Array]], which: Array | slice, ratios: int, order: int
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Sums (M,R) of squared innovations over their variances and of log variances; the largest that lags.

    A reading that is false pulls the filter, so that the next is off to the other side. After a sudden motion the next
    one is off to the same side, by less: a quarter tells it from noise.
    `gains` as in `_gains`, by group of joints; `which` (M,): the group of each joint.
    """
    x, y = np.zeros((order, *y.shape[1:], ratios)), np.where(np.isfinite(y), y, 0.0)[..., None]
    squares, nu, lag, lead, more, wide = np.zeros((6, *x.shape[1:]))
    logs, recent = np.zeros(()), np.zeros((2, *squares.shape))
    begins: Array = np.any(steps.fresh, axis=(1, 2))
    for i, (gain, weight, log) in enumerate(gains):
        carry(x, steps.dt[i, ..., None])
        if begins[i]:
            x[:, steps.fresh[i]] = 0.0
            x[0, steps.fresh[i]] = y[i, steps.fresh[i]]
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


def _gains(steps: _Steps, ratios: Array, order: int) -> Iterator[tuple[Array, Array, Array]]:
    """Yield each step's gain (S,U,C,R), 1 over its deviation and its log variance (U,C,R), 0 where it does not count.

    ratios (U,R) of process to noise; covariances are in units of the noise.
    """
    p = np.zeros((order, order, *steps.dt.shape[1:], ratios.shape[1]))
    vague, spread, q = _vague(steps.dt, order)[..., None], _spread(steps.dt, order)[..., None], ratios[:, None]
    begins: Array = np.any(steps.fresh, axis=(1, 2))
    whole: Array = np.all(steps.counts, axis=(1, 2))
    grown = np.empty(p.shape)
    for i, h in enumerate(steps.dt[..., None]):
        carry(p, h)
        carry(p.swapaxes(0, 1), h)
        p += np.multiply(spread[i], q, out=grown)
        if begins[i]:
            p[:, :, steps.fresh[i]] = vague[:, :, steps.fresh[i]]
        s = p[0, 0] + 1.0
        gain = p[0] / s
        p[1:, 1:] -= gain[1:, None] * p[0, 1:]
        p[0] = p[:, 0] = gain
        weight, log = 1.0 / np.sqrt(s), np.log(s)
        if not whole[i]:
            weight *= steps.counts[i, ..., None]
            log *= steps.counts[i, ..., None]
        yield gain, weight, log


def _spread(dt: Array, order: int) -> Array:
    """Covariance (L,S,S,U,C) that unit white noise in the last rate brings within dt (L,U,C) s."""
    found = np.zeros((len(dt), order, order, *dt.shape[1:]))
    grow(np.moveaxis(found, 0, 2), order, 1.0, dt)
    return found


def _vague(dt: Array, order: int) -> Array:
    """Initial covariance (S,S,U,C) of a filter, for the typical step of times dt (L,U,C)."""
    steps = np.array([np.median(own[own > 0]) for own in dt.swapaxes(0, 1)])[:, None] if order > 2 else 1.0
    vague = np.zeros((order, order, *dt.shape[1:]))
    for state in range(order):
        vague[state, state] = VAGUE / steps ** (2 * state)
    return vague


def _same_covariance(*parts: Array) -> tuple[Array, Array | slice]:
    """First column (U,) of each group that is equal in all parts (L,M,…), and each column's group (M,)."""
    keys = [b"".join(part[:, column].tobytes() for part in parts) for column in range(parts[0].shape[1])]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    first = np.array([keys.index(key) for key in numbers])
    return first, slice(None) if len(first) == 1 else np.array([numbers[key] for key in keys])
