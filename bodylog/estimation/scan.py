"""The Gaussian filter kernel: many stretches of one log side by side, one instant of each per numpy call.

State z (K,C) = joint angles, rates and, where drift is given, encoder offsets; the last axis C is the stretch.
"""

from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np

from ..types import Array

R = TypeVar("R", "Readings", "Trace")

GATE = 5.0
"""Standard deviations: a rarer innovation d has its noise raised until its pull falls as GATE²/d (redescending)."""

EVEN = 16
"""Instants after which rounding's asymmetry is taken out of p, where it would grow without bound."""
MANY = 0.6
"""Share of stretches above which all are scanned rather than some copied out and back."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """White acceleration (M,) rad²/s³ of the rates · random walk (M,) rad²/s of encoder offsets or None; or (M,C).

    recalled (M,) bool: joints whose readings are no encoder's but where the arm is wont to be; they are not counted.
    """

    process: Array
    drift: Array | None = None
    recalled: Array | None = None

    @property
    def size(self) -> int:
        """Length K of the state."""
        return len(self.process) * (2 if self.drift is None else 3)


@dataclass(frozen=True, eq=False)
class Readings:
    """What is heard, folded (L,…,C): dt s · encoders, var (L,M,C), NaN where silent · lines (T tracks of D rows).

    A track's row r reads y (L,T,D,C) = jac (L,T,D,M,C) · x with variance var (L,T,D,C); NaN where unseen.
    """

    dt: Array
    encoders: Array
    encoder_var: Array
    y: Array
    jac: Array
    var: Array


@dataclass(frozen=True, eq=False)
class Trace:
    """Per instant: prior mean and covariance of x, posterior state z and covariance p, nats, gains for going back."""

    prior: Array
    prior_cov: Array
    z: Array
    p: Array
    nats: Array
    encoder_d: Array
    back: tuple[Array, Array, Array] | None


def scan(
    readings: Readings, dynamics: Dynamics, z: Array, p: Array, remember: bool = False, into: Trace | None = None
) -> Trace:
    """Filter every stretch from its own start z (K,C), p (K,K,C); `remember` keeps gains for the smoother.

    `into` is a trace of the same shape to overwrite: fresh memory costs as much as the arithmetic.
    """
    z, p = z.copy(), p.copy()
    length, m, _ = readings.encoders.shape
    trace = _empty(readings, len(z), remember) if into is None else into
    propagate = propagator(p, z, dynamics)
    visible: Array = np.any(np.isfinite(readings.y), axis=(1, 2))
    seen, heard = [np.flatnonzero(row) for row in visible], np.isfinite(readings.encoders)
    shape = (length, m + readings.y.shape[1] * readings.y.shape[2], z.shape[1])
    gains, weights, nus = (None, np.zeros(shape), np.zeros(shape)) if trace.back is None else trace.back
    for i in range(length):
        propagate(readings.dt[i])
        if i % EVEN == 0:
            p[:] = 0.5 * (p + p.transpose(1, 0, 2))
        trace.prior[i], trace.prior_cov[i] = z[:m], p[:m, :m]
        back = None if gains is None else gains[i], weights[i], nus[i]
        update(readings, i, heard[i], seen[i], dynamics.recalled, z, p, trace.encoder_d[i], back)
        trace.z[i], trace.p[i] = z, p
    trace.nats[:] = _nats(weights, nus, dynamics.recalled)
    return trace


def _nats(weights: Array, nus: Array, recalled: Array | None) -> Array:
    """Free energy (L,C) of innovations (L,rows,C) with these weights, 0 where nothing was heard."""
    if recalled is not None:
        weights = weights * ~np.pad(recalled, (0, weights.shape[1] - len(recalled)))[:, None]
    spread = 2.0 * np.pi / np.where(weights > 0, weights, 2.0 * np.pi)
    return np.asarray(0.5 * (nus * nus * weights + np.log(spread)).sum(axis=1))


def rescan(
    readings: Readings, dynamics: Dynamics, z: Array, p: Array, moving: Array, trace: Trace | None,
    remember: bool = False,
) -> Trace:  # fmt: skip
    """`scan`, but only of the stretches `moving` (C,); the others stay as they are in `trace`, which is overwritten."""
    if trace is None or moving.mean() > MANY:
        return scan(readings, dynamics, z, p, remember, into=trace)
    part = scan(columns(readings, moving), dynamics, z[:, moving], p[:, :, moving], remember)
    for field in fields(part):
        if field.name != "back":
            getattr(trace, field.name)[..., moving] = getattr(part, field.name)
    for whole, some in zip(trace.back or (), part.back or (), strict=True):
        whole[..., moving] = some
    return trace


def columns(record: R, some: Array) -> R:
    """The record (Readings or Trace) of the stretches `some` (C,) alone."""

    def cut(part: Any) -> Any:
        return part if part is None else part[..., some] if isinstance(part, np.ndarray) else tuple(map(cut, part))

    return type(record)(*(cut(getattr(record, field.name)) for field in fields(record)))


def _empty(readings: Readings, k: int, remember: bool) -> Trace:
    length, m, c = readings.encoders.shape
    rows = m + readings.y.shape[1] * readings.y.shape[2]
    back = (np.zeros((length, rows, k, c)), np.zeros((length, rows, c)), np.zeros((length, rows, c)))
    return Trace(
        np.empty((length, m, c)), np.empty((length, m, m, c)), np.empty((length, k, c)), np.empty((length, k, k, c)),
        np.empty((length, c)), np.empty((length, m, c)), back if remember else None,
    )  # fmt: skip


def propagator(p: Array, z: Array, dynamics: Dynamics):  # type: ignore[no-untyped-def]
    """A function of dt (C,) that moves z and p in place: constant velocity, exact discretisation."""
    m = len(dynamics.process)
    q = dynamics.process.reshape(m, -1)
    walk = None if dynamics.drift is None else dynamics.drift.reshape(m, -1)
    diagonal = np.einsum("iic->ic", p)
    cross, mirror = np.einsum("iic->ic", p[:m, m : 2 * m]), np.einsum("iic->ic", p[m : 2 * m, :m])
    x, v = z[:m], z[m : 2 * m]

    def propagate(dt: Array) -> None:
        x_step = dt * v
        np.add(x, x_step, out=x)
        p[:m] += dt * p[m : 2 * m]
        p[:, :m] += dt * p[:, m : 2 * m]
        qdt = q * dt
        half = 0.5 * dt * qdt
        diagonal[:m] += (2.0 / 3.0) * dt * half
        diagonal[m : 2 * m] += qdt
        np.add(cross, half, out=cross)
        np.add(mirror, half, out=mirror)
        if walk is not None:
            diagonal[2 * m :] += walk * dt

    return propagate


def update(
    readings: Readings, i: int, heard: Array, seen: Array, recalled: Array | None, z: Array, p: Array,
    encoder_d: Array, back: tuple[Array | None, Array, Array],
) -> None:  # fmt: skip
    """Condition z, p in place on all that is heard at instant i, tracks in the stretches `seen` alone.

    Noise is gated by the prior, so order is no matter. `back` takes gains, weights and innovations of all rows.
    """
    m, (gains, weights, nus) = readings.encoders.shape[1], back
    joint_var, encoder_d[:] = _gated_encoders(readings.encoders[i], readings.encoder_var[i], z, p, m)
    if recalled is not None:
        joint_var[recalled], encoder_d[recalled] = readings.encoder_var[i][recalled], np.nan
    if len(seen):
        lines = (part[i].take(seen, axis=-1) for part in (readings.y, readings.jac, readings.var))
        _see(*lines, seen, z, p, (None if gains is None else gains[m:], weights[m:], nus[m:]))
    said = np.where(heard, readings.encoders[i], 0.0)
    for j in range(m):
        ph = p[:, j] if len(z) == 2 * m else p[:, j] + p[:, 2 * m + j]
        s = joint_var[j] + (ph[j] if len(z) == 2 * m else ph[j] + ph[2 * m + j])
        nus[j] = said[j] - (z[j] if len(z) == 2 * m else z[j] + z[2 * m + j])
        weights[j] = heard[j] / s
        gain = _condition(z, p, ph, weights[j], nus[j])
        if gains is not None:
            gains[j] = gain


def _see(
    y: Array, jac: Array, var: Array, seen: Array, z: Array, p: Array, back: tuple[Array | None, Array, Array]
) -> None:
    """Condition the stretches `seen` of z, p in place on their tracks' rows y, var (T,2,C'), jac (T,2,M,C')."""
    m, some_z, some_p, (gains, weights, nus) = jac.shape[2], z.take(seen, axis=1), p.take(seen, axis=2), back
    priors = [(*_lean(h, some_p), (h * some_z[:m]).sum(axis=1)) for h in jac]
    own = [_gated(s, said - mean, noise) for (_, s, mean), said, noise in zip(priors, y, var, strict=True)]
    for t, h in enumerate(jac):
        # tracks heard before have moved the belief since
        ph, s, mean = priors[0] if t == 0 else (*_lean(h, some_p), (h * some_z[:m]).sum(axis=1))
        heard = np.isfinite(y[t])
        nu = np.where(heard, y[t] - mean, 0.0)
        for d in range(2):
            weight = heard[d] / (s[d, d] + own[t][d])
            gain = _condition(some_z, some_p, ph[d], weight, nu[d])
            weights[2 * t + d][seen], nus[2 * t + d][seen] = weight, nu[d]
            if gains is not None:
                gains[2 * t + d][:, seen] = gain
            if d == 0:
                share = weight * s[0, 1]
                ph[1], s[1, 1], nu[1] = ph[1] - share * ph[0], s[1, 1] - share * s[0, 1], nu[1] - share * nu[0]
    z[:, seen], p[:, :, seen] = some_z, some_p


def _lean(h: Array, p: Array) -> tuple[Array, Array]:
    """P Hᵀ (2,K,C) and H P Hᵀ (2,2,C) of rows h (2,M,C) under p (K,K,C)."""
    m = h.shape[1]
    ph = (h[:, None] * p[:, :m]).sum(axis=2)
    return ph, (h * ph[:, None, :m]).sum(axis=2)


def _gated(s: Array, nu: Array, var: Array) -> Array:
    """Variances (2,C) of a track's rows after gating it as a whole; H P Hᵀ s (2,2,C), innovations nu (2,C)."""
    a, b, c = s[0, 0] + var[0], s[0, 1], s[1, 1] + var[1]
    d2 = (c * nu[0] ** 2 - 2.0 * b * nu[0] * nu[1] + a * nu[1] ** 2) / (a * c - b * b)
    return var + np.stack([a, c]) * _excess(d2)


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
