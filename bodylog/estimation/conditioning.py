"""The belief conditioned on all that is heard at one instant, in many stretches of a log at once."""

from typing import TYPE_CHECKING

import numpy as np

from ..types import Array

if TYPE_CHECKING:
    from .scan import Pooled, Readings

MANY = 0.6
"""Share of stretches above which all are worked on rather than some copied out and back."""
GATE = 5.0
"""Standard deviations: a rarer innovation d has its noise raised until its pull falls as GATE²/d (redescending)."""


def update(
    readings: "Readings", i: int, heard: Array, seen: Array, recalled: Array | None, z: Array, p: Array,
    encoder_d: Array, back: tuple[Array | None, Array, Array],
) -> None:  # fmt: skip
    """Condition z, p in place on all that is heard at instant i, tracks in the stretches `seen` alone.

    Noise is gated by the prior, so order is no matter. `back` takes gains, weights and innovations of all rows.
    """
    m, (gains, weights, nus) = readings.encoders.shape[1], back
    spoken = bool(heard.any())
    if spoken:
        joint_var, encoder_d[:] = _gated_encoders(readings.encoders[i], readings.encoder_var[i], z, p, m)
        if recalled is not None:
            joint_var[recalled], encoder_d[recalled] = readings.encoder_var[i][recalled], np.nan
    else:
        encoder_d[:] = np.nan
    if len(seen):
        _look(readings, i, seen, z, p, (None if gains is None else gains[m:], weights[m:], nus[m:]))
    for j in range(m if spoken else 0):
        ph = p[:, j] if len(z) == 2 * m else p[:, j] + p[:, 2 * m + j]
        s = joint_var[j] + (ph[j] if len(z) == 2 * m else ph[j] + ph[2 * m + j])
        said = readings.encoders[i, j] - (z[j] if len(z) == 2 * m else z[j] + z[2 * m + j])
        nus[j] = np.where(heard[j], said, 0.0)
        np.divide(heard[j], s, out=weights[j])
        gain = _condition(z, p, ph, weights[j], nus[j])
        if gains is not None:
            gains[j] = gain


def leap(pooled: "Pooled", i: int, z: Array, p: Array, back: tuple[Array | None, Array, Array]) -> None:
    """Condition z, p in place on what was pooled before instant i, ungated, and move them there."""
    lean, (gains, weights, nus) = pooled.lean[i], back
    m = len(lean)
    for row in range(2 * m):
        of_rate, j = divmod(row, m)
        ph, mean = p[:, m + j], z[m + j]
        if not of_rate:
            ph, mean = lean[j] * ph + p[:, j], lean[j] * mean + z[j]
            if len(z) > 2 * m:
                ph, mean = ph + p[:, 2 * m + j], mean + z[2 * m + j]
        s = ph[m + j] if of_rate else lean[j] * ph[m + j] + ph[j]
        if len(z) > 2 * m and not of_rate:
            s = s + ph[2 * m + j]
        np.subtract(pooled.y[i, of_rate, j], mean, out=nus[row])
        np.divide(1.0, s + pooled.var[i, of_rate, j], out=weights[row])
        gain = _condition(z, p, ph, weights[row], nus[row])
        if gains is not None:
            gains[row] = gain
    _move(pooled.move[i], pooled.shift[i], pooled.noise[i], z, p)


def _move(move: Array, shift: Array, noise: Array, z: Array, p: Array) -> None:
    """z (K,C) and p (K,K,C), in place, through move (S,S,M,C) and shift (S,M,C) of each joint's own states."""
    states, m, c = shift.shape
    z[:] = (np.einsum("abjc,bjc->ajc", move, z.reshape(states, m, c)) + shift).reshape(z.shape)
    half = np.einsum("abjc,bjkc->ajkc", move, p.reshape(states, m, -1, c)).reshape(-1, states, m, c)
    np.einsum("abjc,kbjc->kajc", move, half, out=p.reshape(-1, states, m, c))
    np.einsum("ajbjc->abjc", p.reshape(states, m, states, m, c))[:] += noise


def _look(
    readings: "Readings", i: int, seen: Array, z: Array, p: Array, back: tuple[Array | None, Array, Array]
) -> None:
    """Condition z, p in place on the tracks' rows at instant i, in the stretches `seen` alone where they are few."""
    gains, weights, nus = back
    if len(seen) > MANY * z.shape[1]:
        _see(readings.y[i], readings.jac[i], readings.var[i], z, p, back)
        return
    y, jac, var = (part[i].take(seen, axis=-1) for part in (readings.y, readings.jac, readings.var))
    some_z, some_p, rows = z.take(seen, axis=1), p.take(seen, axis=2), y.shape[0] * y.shape[1]
    some_gains = None if gains is None else np.empty((rows, *some_z.shape))
    some_weights, some_nus = np.empty((2, rows, len(seen)))
    _see(y, jac, var, some_z, some_p, (some_gains, some_weights, some_nus))
    z[:, seen], p[:, :, seen] = some_z, some_p
    weights[:rows, seen], nus[:rows, seen] = some_weights, some_nus
    if gains is not None:
        gains[:rows, :, seen] = some_gains


def _see(y: Array, jac: Array, var: Array, z: Array, p: Array, back: tuple[Array | None, Array, Array]) -> None:
    """Condition z, p in place on tracks' rows y, var (T,2,C), jac (T,2,M,C)."""
    m, (gains, weights, nus) = jac.shape[2], back
    priors = [(*_lean(h, p), (h * z[:m]).sum(axis=1)) for h in jac]
    own = [_gated(s, said - mean, noise) for (_, s, mean), said, noise in zip(priors, y, var, strict=True)]
    for t, h in enumerate(jac):
        # tracks heard before have moved the belief since
        ph, s, mean = priors[0] if t == 0 else (*_lean(h, p), (h * z[:m]).sum(axis=1))
        heard = np.isfinite(y[t])
        nu = np.where(heard, y[t] - mean, 0.0)
        for d in range(2):
            weight = heard[d] / (s[d, d] + own[t][d])
            gain = _condition(z, p, ph[d], weight, nu[d])
            weights[2 * t + d], nus[2 * t + d] = weight, nu[d]
            if gains is not None:
                gains[2 * t + d] = gain
            if d == 0:
                share = weight * s[0, 1]
                ph[1], s[1, 1], nu[1] = ph[1] - share * ph[0], s[1, 1] - share * s[0, 1], nu[1] - share * nu[0]


def _lean(h: Array, p: Array) -> tuple[Array, Array]:
    """P Hᵀ (2,K,C) and H P Hᵀ (2,2,C) of rows h (2,M,C) under p (K,K,C)."""
    m = h.shape[1]
    ph = np.einsum("dmc,kmc->dkc", h, p[:, :m])
    return ph, np.einsum("emc,dmc->dec", h, ph[:, :m])


def _gated(s: Array, nu: Array, var: Array) -> Array:
    """Variances (2,C) of a track's rows after gating it as a whole; H P Hᵀ s (2,2,C), innovations nu (2,C)."""
    a, b, c = s[0, 0] + var[0], s[0, 1], s[1, 1] + var[1]
    d2 = (c * nu[0] ** 2 - 2.0 * b * nu[0] * nu[1] + a * nu[1] ** 2) / (a * c - b * b)
    return np.asarray(var + np.stack([a, c]) * _excess(d2))


def _condition(z: Array, p: Array, ph: Array, weight: Array, nu: Array) -> Array:
    """One scalar reading: innovation nu (C,), its weight (C,), 0 where silent, ph = P Hᵀ (K,C); the gain (K,C)."""
    gain = ph * weight
    z += gain * nu
    p -= gain[:, None] * ph[None]
    return gain


def _gated_encoders(y: Array, var: Array, z: Array, p: Array, m: int) -> tuple[Array, Array]:
    """Encoder variances (M,C) after gating, and the innovations in standard deviations (M,C)."""
    diagonal = np.einsum("iic->ic", p)
    s, nu = diagonal[:m] + var, y - z[:m]
    if len(z) > 2 * m:
        s = s + diagonal[2 * m :] + 2.0 * np.einsum("iic->ic", p[:m, 2 * m :])
        nu = nu - z[2 * m :]
    d = nu / np.sqrt(s)
    return var + s * _excess(d * d), d


def _excess(d2: Array) -> Array:
    """By how many prior variances the noise must grow: 0 inside the gate, (d/GATE)⁴ − 1 outside; NaN is inside."""
    over = d2 > GATE * GATE
    return np.where(over, (d2 / (GATE * GATE)) ** 2 - 1.0, 0.0) if over.any() else np.zeros_like(d2)
