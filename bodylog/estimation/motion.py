"""Encoder noise and white acceleration of each joint, from the evidence of its own readings under constant velocity."""

import numpy as np

from ..types import Array
from .folds import Fold
from .grain import dithered, repeated
from .senses import Encoders

SPREAD = (31, 13, 13)
"""Ratios tried at first, over all magnitudes, and twice more between the best one's neighbours."""
VAGUE = 1e8
"""Noise variances: how little a filter that starts anew knows."""
SPACING = 0.01
"""s: readings closer than this are averaged, for a stretch too short to show how a joint accelerates shows nothing."""
MOST = 6000
"""Averages used at most, from the middle of the log: more would not sharpen two numbers per joint."""
STRETCH = 128
"""Averages filtered one after the other, many such stretches side by side."""
SKIP = 3
"""Readings per stretch that only start the filter and do not count."""
FEWEST = 30
"""Readings of a joint that say nothing certain of its noise."""
BREAK = 10.0
"""Robust standard deviations: a larger second difference is a jump, where the filter starts anew."""
MEMORY = 1.0
"""Seconds of readings a belief about a resting joint may average."""


def learn(encoders: Encoders, encoder: Array, process: Array) -> tuple[Array, Array]:
    """Encoder variances (M,) rad² and acceleration densities (M,) rad²/s³; a joint too silent keeps what is given.

    Readings that are counted in steps are spread over them to learn from, and are as noisy as these at least.
    """
    encoder, process, joints, heard, coarse = encoder.copy(), process.copy(), [], [], []
    for joint, column in enumerate(encoders.values.T):
        known = np.flatnonzero(np.isfinite(column))
        most = MOST * _fellows(encoders.t[known])
        begin = max(0, (len(known) - most) // 2)
        known = known[begin : begin + most]
        if len(known) > FEWEST and np.ptp(column[known]) > 0.0:
            joints.append(joint)
            spread, *own = dithered(encoders.t[known], column[known])
            heard.append((encoders.t[known], spread))
            coarse.append(own)
        elif len(known):
            encoder[joint] *= repeated(encoders.t[known], column[known])
    if joints:
        (found, process[joints]), (added, least) = likeliest(heard), np.transpose(coarse)
        encoder[joints] = np.maximum(found - added, least)
    return encoder, np.maximum(process, floor(encoders, encoder))


def floor(encoders: Encoders, encoder: Array) -> Array:
    """Least acceleration density (M,) rad²/s³: no joint is trusted to hold still for longer than MEMORY."""
    step = float(np.median(np.diff(encoders.t))) if len(encoders.t) > 1 else 0.0
    # the filter's memory is (R·dt/q)^(1/4)
    return np.asarray(encoder * step / MEMORY**4)


def likeliest(heard: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Noise variances and acceleration densities (M,) that maximise the evidence of each joint's times and readings."""
    fellows = np.array([_fellows(t) for t, _ in heard])
    means = [_averaged(t, y, k) for (t, y), k in zip(heard, fellows, strict=True)]
    told = _side_by_side(means)
    step = np.array([float(np.median(np.diff(t))) for t, *_ in means])
    # process / noise variance, scaled so that 1 is balanced per reading
    ratios, joints = np.geomspace(1e-9, 1e6, SPREAD[0])[:, None] / step**3, np.arange(len(heard))
    for count in (*SPREAD[1:], 0):
        score, noise = evidence(*told, ratios)
        best = score.argmax(axis=0)
        found = noise[best, joints] * fellows, noise[best, joints] * ratios[best, joints]
        low, high = ratios[np.maximum(best - 1, 0), joints], ratios[np.minimum(best + 1, len(ratios) - 1), joints]
        ratios = np.geomspace(low, high, count)
    return found


def _fellows(t: Array) -> int:
    """How many readings in a row make one average."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else SPACING
    return max(1, min(round(SPACING / max(step, 1e-9)), len(t) // FEWEST))


def _averaged(t: Array, y: Array, fellows: int) -> tuple[Array, Array, Array]:
    """Means (N,) of times and of readings, and where the filter starts anew: about a break, which is in a mean."""
    whole = len(t) // fellows * fellows
    broken = _breaks(t, y)
    t, y = (a[:whole].reshape(-1, fellows).mean(axis=1) for a in (t, y))
    if fellows > 1:
        broken = np.asarray(broken[:whole].reshape(-1, fellows).any(axis=1))
        broken[1:] |= broken[:-1]
        broken |= _breaks(t, y)
    return t, y, broken


def _side_by_side(heard: list[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
    """Time steps, readings (NaN after the last) and where the filter starts anew, folded: (L,M,C) each."""
    most = max(len(t) for t, *_ in heard)
    dt, y, fresh = np.zeros((most, len(heard))), np.full((most, len(heard)), np.nan), np.ones((most, len(heard)), bool)
    for joint, (t, column, anew) in enumerate(heard):
        rows = slice(len(t)), joint
        dt[rows], y[rows], fresh[rows] = np.diff(t, prepend=t[0]), column, anew
    fold = Fold(most, STRETCH, -(-most // STRETCH))
    return fold.fold(dt, 0.0), fold.fold(y, np.nan), fold.fold(fresh, 1.0) > 0


def evidence(dt: Array, y: Array, fresh: Array, ratios: Array) -> tuple[Array, Array]:
    """Log evidence (R,M) per ratio process/noise (R,M), with the noise variance that maximises it given the ratio."""
    shape, q = (*ratios.shape, y.shape[2]), ratios[:, :, None]
    x, v, pxx, pxv, pvv, squares, logs = np.zeros((7, *shape))
    age, count, finite = np.zeros(y.shape[1:]), np.zeros(y.shape[1:]), np.isfinite(y)
    for i, h in enumerate(dt):
        anew = fresh[i] | (i == 0)
        qh, cross = q * h, h * pvv
        x, pxx = x + h * v, pxx + h * (pxv + pxv + cross + qh * (h / 3.0))
        pxv, pvv = pxv + cross + qh * (0.5 * h), pvv + qh
        age = np.where(anew, 0.0, age + 1.0)
        if anew.any():
            x, v, pxv = np.where(anew, y[i], x), np.where(anew, 0.0, v), np.where(anew, 0.0, pxv)
            pxx, pvv = np.where(anew, VAGUE, pxx), np.where(anew, VAGUE, pvv)
        s, nu = pxx + 1.0, np.where(finite[i], y[i] - x, 0.0)
        counts = (age >= SKIP) & finite[i]
        gx, gv = pxx / s, pxv / s
        squares += nu * nu * (counts / s)
        logs += counts * np.log(s)
        count += counts
        x, v = x + gx * nu, v + gv * nu
        pvv, pxv, pxx = pvv - gv * pxv, pxv - gx * pxv, gx
    n = np.maximum(count.sum(axis=1), 1.0)
    noise = squares.sum(axis=2) / n
    return -0.5 * (n * np.log(noise) + logs.sum(axis=2)), noise


def _breaks(t: Array, y: Array) -> Array:
    """Where the reading cannot follow from its neighbours (N,): the filter starts anew there."""
    bend = np.abs(np.diff(y, 2))
    typical = 1.4826 * np.median(bend) + np.finfo(float).tiny
    gap = np.diff(t) > 20.0 * np.median(np.diff(t))
    fresh = np.zeros(len(y), bool)
    fresh[1:-1] = bend > BREAK * typical
    fresh[2:] |= bend > BREAK * typical
    fresh[1:] |= gap
    return fresh
