"""Encoder noise and white acceleration of each joint, from the evidence of its own readings under constant velocity."""

import numpy as np

from ...types import Array
from ..inference.folds import Fold
from ..measurements.records import Encoders
from .quantisation import dithered, repeated
from .sudden_motion import followed

SPREAD = (31, 9)
"""Ratios tried at first, over all magnitudes, and then between the best one's neighbours."""
VAGUE = 1e8
"""Noise variances: how little a filter that starts anew knows."""
SPACING = 0.01
"""s: readings closer than this are averaged, for a stretch too short to show how a joint accelerates shows nothing."""
MOST = 6000
"""Averages used at most, from the middle of the log: more would not sharpen two numbers per joint."""
STRETCH = 512
"""Averages filtered one after the other, many such stretches side by side: short ones cannot tell slow motion."""
SKIP = 3
"""Readings per stretch that only start the filter and do not count."""
FEWEST = 30
"""Readings of a joint that say nothing certain of its noise."""
BREAK = 10.0
"""Robust standard deviations: a larger second difference is a jump, where the filter starts anew."""
AROUND = 5
"""Second differences on each side among which that of a jump stands alone."""
MEMORY = 1.0
"""Seconds of readings a belief about a resting joint may average."""
LEAST = 1e-12
"""rad²: no encoder errs by less than a microradian, a twentieth of the step of a 19-bit one."""


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
        (found, density), (added, least) = likeliest(heard), np.transpose(coarse)
        encoder[joints] = np.maximum(found - added, least)
        noise = np.maximum(found, encoder[joints])
        process[joints] = [_followed(*one) for one in zip(heard, noise, density, strict=True)]
    return encoder, process


def _followed(heard: tuple[Array, Array], noise: float, process: float) -> float:
    """The density that the motion in times and readings (N,) asks for, `process` at least."""
    t, y = heard
    return followed(t, y, _alone(np.abs(np.diff(y, 2))), noise, process)


def followable(encoders: Encoders, encoder: Array, process: Array) -> Array:
    """Densities (M,) rad²/s³, at least `process`, with which a filter follows all that the encoders read."""
    process = process.copy()
    for joint, column in enumerate(encoders.values.T):
        known = np.isfinite(column)
        process[joint] = _followed((encoders.t[known], column[known]), encoder[joint], process[joint])
    return process


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
    ratios = np.geomspace(1e-9, 1e6, SPREAD[0])[:, None] / step**3
    best, joints = evidence(*told, ratios)[0].argmax(axis=0), np.arange(len(heard))
    low, high = (ratios[np.clip(best + side, 0, len(ratios) - 1), joints] for side in (-1, 1))
    ratios = np.geomspace(low, high, SPREAD[1])
    ratio, noise = _peak(ratios, *evidence(*told, ratios))
    return noise * fellows, noise * ratio


def _peak(ratios: Array, score: Array, noise: Array) -> tuple[Array, Array]:
    """Ratios and noise (M,) where the score (R,M) is greatest, by the parabola through the best of them."""
    at = np.clip(score.argmax(axis=0), 1, len(ratios) - 2), np.arange(ratios.shape[1])
    (r0, r1, r2), (s0, s1, s2), (n0, n1, n2) = (
        [a[at[0] + side, at[1]] for side in (-1, 0, 1)] for a in (np.log(ratios), score, np.log(noise))
    )
    bend = np.minimum(s0 - 2.0 * s1 + s2, -np.finfo(float).tiny)
    shift = np.clip(0.5 * (s0 - s2) / bend, -1.0, 1.0)
    return np.exp(r1 + 0.5 * shift * (r2 - r0)), np.exp(n1 + 0.5 * shift * (n2 - n0))


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
    finite, count = np.isfinite(y), np.arange(len(y))[:, None, None]
    fresh = np.asarray(fresh | (count == 0))
    counts = np.asarray(finite & (count - np.maximum.accumulate(np.where(fresh, count, 0)) >= SKIP))
    begins = np.asarray(fresh.any(axis=(1, 2)))
    for i, h in enumerate(dt):
        qh, cross = q * h, h * pvv
        x, pxx = x + h * v, pxx + h * (pxv + pxv + cross + qh * (h / 3.0))
        pxv, pvv = pxv + cross + qh * (0.5 * h), pvv + qh
        if begins[i]:
            x, v, pxv = np.where(fresh[i], y[i], x), np.where(fresh[i], 0.0, v), np.where(fresh[i], 0.0, pxv)
            pxx, pvv = np.where(fresh[i], VAGUE, pxx), np.where(fresh[i], VAGUE, pvv)
        s, nu = pxx + 1.0, np.where(finite[i], y[i] - x, 0.0)
        gx, gv = pxx / s, pxv / s
        squares += nu * nu * (counts[i] / s)
        logs += counts[i] * np.log(s)
        x, v = x + gx * nu, v + gv * nu
        pvv, pxv, pxx = pvv - gv * pxv, pxv - gx * pxv, gx
    n, misfit = np.maximum(counts.sum(axis=(0, 2)), 1.0), squares.sum(axis=2)
    noise = np.maximum(misfit / n, LEAST)
    return -0.5 * (n * np.log(noise) + misfit / noise + logs.sum(axis=2)), noise


def _breaks(t: Array, y: Array) -> Array:
    """Where the reading cannot follow from its neighbours (N,): the filter starts anew there."""
    bend = np.abs(np.diff(y, 2))
    gap = np.diff(t) > 20.0 * np.median(np.diff(t))
    alone = _alone(bend)
    fresh = np.zeros(len(y), bool)
    fresh[1:-1] = alone
    fresh[2:] |= alone
    fresh[1:] |= gap
    return fresh


def _alone(bend: Array) -> Array:
    """Which bends (N,) stand out of all others, and of those around them: an arm that starts to move goes on."""
    moved = bend[bend > 0.0]
    # where most readings repeat, what the others do is typical
    typical = np.median(bend) if 2 * len(moved) > len(bend) else np.median(moved) if len(moved) else np.inf
    found = bend > BREAK * 1.4826 * typical
    at = np.flatnonzero(found)
    around = np.pad(bend, AROUND)[at[:, None] + np.arange(2 * AROUND + 1)]
    found[at] = bend[at] > BREAK * np.median(around, axis=1)
    return np.asarray(found)
