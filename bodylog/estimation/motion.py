"""Encoder noise and white acceleration of each joint, from the evidence of its own readings under constant velocity."""

import numpy as np

from ..types import Array
from .folds import Fold
from .senses import Encoders

SPREAD = 17
MOST = 6000
"""Readings used at most, from the middle of the log: more would not sharpen two numbers per joint."""
STRETCH = 128
"""Readings filtered one after the other, many such stretches side by side."""
SKIP = 3
"""Readings per stretch that only start the filter and do not count."""
BREAK = 10.0
"""Robust standard deviations: a larger second difference is a jump, where the filter starts anew."""

MEMORY = 1.0
"""Seconds of readings a belief about a resting joint may average."""


def learn(encoders: Encoders, encoder: Array, process: Array) -> tuple[Array, Array]:
    """Encoder variances (M,) rad² and acceleration densities (M,) rad²/s³; a joint too silent keeps what is given."""
    encoder, process = encoder.copy(), process.copy()
    for joint in range(encoders.values.shape[1]):
        known = np.flatnonzero(np.isfinite(encoders.values[:, joint]))
        begin = max(0, (len(known) - MOST) // 2)
        known = known[begin : begin + MOST]
        if len(known) > 10 * SKIP:
            found = learn_one(encoders.t[known], encoders.values[known, joint])
            encoder[joint], process[joint] = found if found is not None else (encoder[joint], process[joint])
    return encoder, np.maximum(process, floor(encoders, encoder))


def floor(encoders: Encoders, encoder: Array) -> Array:
    """Least acceleration density (M,) rad²/s³: no joint is trusted to hold still for longer than MEMORY."""
    step = float(np.median(np.diff(encoders.t))) if len(encoders.t) > 1 else 0.0
    # the filter's memory is (R·dt/q)^(1/4)
    return np.asarray(encoder * step / MEMORY**4)


def learn_one(t: Array, y: Array) -> tuple[float, float] | None:
    """Noise variance and acceleration density of one joint that maximise the evidence; None when it never changes."""
    if np.ptp(y) == 0.0:
        return None
    fold = Fold(len(t), STRETCH, -(-len(t) // STRETCH))
    fresh = _breaks(t, y)
    step = float(np.median(np.diff(t)))
    ratios = np.geomspace(1e-9, 1e6, 31) / step**3  # process / noise variance, scaled so that 1 is balanced per reading
    for _ in range(3):
        score, noise = evidence(t, y, fresh, ratios, fold)
        best = int(np.argmax(score))
        low, high = ratios[max(best - 1, 0)], ratios[min(best + 1, len(ratios) - 1)]
        found = float(noise[best]), float(noise[best] * ratios[best])
        ratios = np.geomspace(low, high, SPREAD)
    return found


def evidence(t: Array, y: Array, fresh: Array, ratios: Array, fold: Fold) -> tuple[Array, Array]:
    """Log evidence (R,) per ratio process/noise, with the noise variance (R,) that maximises it given the ratio."""
    dt = fold.fold(np.diff(t, prepend=t[0]), np.nan)
    y, fresh = fold.fold(y, np.nan), fold.fold(fresh, 1.0)
    x, v = np.zeros((2, len(ratios), fold.count))
    pxx, pxv, pvv = np.zeros((3, len(ratios), fold.count))
    squares, logs, count = np.zeros((3, len(ratios), fold.count))
    age = np.zeros(fold.count)
    q = ratios[:, None]
    for i in range(fold.length):
        h, anew = dt[i], (fresh[i] > 0) | (i == 0)
        x = x + h * v
        pxx = pxx + h * (2.0 * pxv + h * pvv) + q * h**3 / 3.0
        pxv = pxv + h * pvv + q * h**2 / 2.0
        pvv = pvv + q * h
        age = np.where(anew, 0, age + 1)
        x, v = np.where(anew, y[i], x), np.where(anew, 0.0, v)
        pxx, pxv, pvv = np.where(anew, 1e8, pxx), np.where(anew, 0.0, pxv), np.where(anew, 1e8, pvv)
        s, nu = pxx + 1.0, y[i] - x
        counts = (age >= SKIP) & np.isfinite(nu)
        squares += np.where(counts, nu * nu / s, 0.0)
        logs += np.where(counts, np.log(s), 0.0)
        count += counts
        gx, gv = pxx / s, pxv / s
        x, v = x + gx * nu, v + gv * nu
        pvv, pxv, pxx = pvv - gv * pxv, pxv - gx * pxv, pxx - gx * pxx
    n = np.maximum(count.sum(axis=1), 1.0)
    noise = squares.sum(axis=1) / n
    return -0.5 * (n * np.log(noise) + logs.sum(axis=1)), noise


def _breaks(t: Array, y: Array) -> Array:
    """1 where the reading cannot follow from its neighbours (N,): the filter starts anew there."""
    bend = np.abs(np.diff(y, 2))
    typical = 1.4826 * np.median(bend) + np.finfo(float).tiny
    gap = np.diff(t) > 20.0 * np.median(np.diff(t))
    fresh = np.zeros(len(y))
    fresh[1:-1] = bend > BREAK * typical
    fresh[2:][bend > BREAK * typical] = 1.0
    fresh[1:][gap] = 1.0
    return fresh
