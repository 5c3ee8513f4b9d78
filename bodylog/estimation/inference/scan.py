"""The Gaussian filter kernel: many stretches of one log in parallel, one instant of each per numpy call.

State z (K,C) = joint angles, rates[, accelerations][, encoder offsets]; the last axis C is the stretch.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np

from ...types import Array
from .conditioning import MANY, AdjointRecord, Rows, advance, condition_pooled, update
from .filter_records import Dynamics, KnotReadings, Pooled, Readings
from .motion import carry, grow
from .reacquisition import forget

R = TypeVar("R", "Readings", "Trace", "Pooled")

EVEN = {2: 16, 3: 4}
"""Instants after which p is made symmetric, before rounding errors grow, by the motion's order."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Per instant: prior mean and covariance of x, posterior state z and covariance p, nats; for the smoother:

    gains, weights and innovations of rows · left (L,K,K+1,C): covariance and mean after the pooled readings.
    """

    prior: Array
    prior_cov: Array
    z: Array
    p: Array
    nats: Array
    encoder_d: Array
    back: tuple[Array, Array, Array] | None
    left: Array | None


def scan(
    readings: Readings, dynamics: Dynamics, z: Array, p: Array, remember: bool = False, into: Trace | None = None,
    every: int = 1,
) -> Trace:  # fmt: skip
    """Filter every stretch from its own start z (K,C), p (K,K,C); `remember` keeps what the smoother needs.

    `into`: a trace of the same shape to overwrite, as fresh memory costs as much as the arithmetic. Only every
    `every`-th stretch keeps more than nats.
    """
    belief = np.empty((len(z), len(z) + 1, z.shape[1]))
    belief[:, :-1], belief[:, -1] = p, z
    p, z = belief[:, :-1], belief[:, -1]
    length, m, c = readings.encoders.shape
    order, offset, more = dynamics.order, dynamics.offset, np.zeros((length, c))
    trace, kept, errors = into or _empty(readings, len(z), remember, every), slice(None, None, every), np.empty((m, c))
    propagate = propagator(belief, dynamics)
    measured = Rows.of(readings.encoders, readings.encoder_var), Rows.of(readings.y, readings.var)
    visible: Array = np.any(measured[1].present, axis=(1, 2))
    seen = [np.flatnonzero(row) for row in visible]
    back = AdjointRecord(*(trace.back or (None, *np.zeros((2, length, _rows(readings), c)))))
    reset = {} if readings.reset is None else {i: joints for i, joints in enumerate(readings.reset) if joints.any()}
    leaps = AdjointRecord(None, *np.empty((2, length, order * m if isinstance(readings, KnotReadings) else 0, c)))
    for i in range(length):
        if isinstance(readings, KnotReadings):
            left = None if trace.left is None else trace.left[i]
            condition_pooled(readings.pooled, i, belief, leaps.at(i), left, offset)
        elif readings.moves is not None:
            move, shift, noise = (part[i] for part in readings.moves)
            advance(move, shift, noise, belief)
        else:
            propagate(readings.dt[i], None if readings.more is None else readings.more[i])
        if i in reset:
            forget(z, p, reset[i], readings.encoders[i], readings.dt[i], order)
        if i % EVEN[order] == 0:
            p[:] = 0.5 * (p + p.transpose(1, 0, 2))
        trace.prior[i], trace.prior_cov[i] = z[:m, kept], p[:m, :m, kept]
        update(readings, measured, i, seen[i], dynamics, belief, errors, back.at(i), more[i])
        trace.z[i], trace.p[i], trace.encoder_d[i] = z[:, kept], p[..., kept], errors[:, kept]
    own = np.ones(m, bool) if dynamics.is_prior is None else ~dynamics.is_prior
    trace.nats[:] = _nats(back, own) + more
    if isinstance(readings, KnotReadings):
        trace.nats[:] += _nats(leaps, np.tile(own, order)) + readings.pooled.nats
    return trace


def _nats(back: AdjointRecord, own: Array) -> Array:
    """Free energy (L,C) of innovations, 0 where there are none; of the first rows only `own` ones count."""
    weights, nus = back.weights, back.nus
    if not own.all():
        weights = weights.copy()
        weights[:, : len(own)] *= own[:, None]
    spread = 2.0 * np.pi / np.where(weights > 0, weights, 2.0 * np.pi)
    return np.asarray(0.5 * (nus * nus * weights + np.log(spread)).sum(axis=1))


def rescan(
    readings: Readings, dynamics: Dynamics, z: Array, p: Array, moving: Array, trace: Trace | None,
    remember: bool = False,
) -> Trace:  # fmt: skip
    """`scan` of the stretches `moving` (C,) only; the others keep their part of `trace`, which is overwritten."""
    if trace is None or moving.mean() > MANY:
        return scan(readings, dynamics, z, p, remember, into=trace)
    if not moving.any():
        return trace
    part = scan(columns(readings, moving), dynamics, z[:, moving], p[:, :, moving], remember)
    for one in fields(part):
        if one.name != "back" and (some := getattr(part, one.name)) is not None:
            getattr(trace, one.name)[..., moving] = some
    for whole, some in zip(trace.back or (), part.back or (), strict=True):
        whole[..., moving] = some
    return trace


def columns(record: R, some: Array) -> R:
    """The record (Readings or Trace) of the stretches `some` (C,) only."""

    def cut(part: Any) -> Any:
        if isinstance(part, Pooled):
            return columns(part, some)
        # not part[..., some], which lies in memory the other way round
        whole = isinstance(part, np.ndarray)
        plain = part is None or isinstance(part, float)
        return part if plain else part.compress(some, axis=-1) if whole else tuple(map(cut, part))

    return type(record)(**{one.name: cut(getattr(record, one.name)) for one in fields(record)})


def _rows(readings: Readings) -> int:
    """Rows per instant: M encoders and the tracks' rows."""
    return int(readings.encoders.shape[1] + readings.y.shape[1] * readings.y.shape[2])


def _empty(readings: Readings, k: int, remember: bool, every: int) -> Trace:
    length, m, c = readings.encoders.shape
    rows, nats, c = _rows(readings), np.empty((length, c)), len(range(0, c, every))
    back = (np.zeros((length, rows, k, c)), np.zeros((length, rows, c)), np.zeros((length, rows, c)))
    left = np.empty((length, k, k + 1, c)) if remember and isinstance(readings, KnotReadings) else None
    return Trace(
        np.empty((length, m, c)), np.empty((length, m, m, c)), np.empty((length, k, c)), np.empty((length, k, k, c)),
        nats, np.empty((length, m, c)), back if remember else None, left,
    )  # fmt: skip


def propagator(belief: Array, dynamics: Dynamics) -> Callable[[Array, Array | None], None]:
    """A function of dt (C,) that moves the belief in place: exact discretisation.

    Its second argument (M,C) is a factor on the process variance.
    """
    m, order, offset = len(dynamics.process), dynamics.order, dynamics.offset
    q = dynamics.process.reshape(m, -1)
    walk = None if dynamics.drift is None else dynamics.drift.reshape(m, -1)
    k, c = len(belief), belief.shape[-1]
    rows = belief[: order * m].reshape(order, m, k + 1, c)
    columns = [belief[:, state * m : state * m + m] for state in range(order)]
    blocks = {(r, s): np.einsum("iic->ic", rows[r, :, s * m : s * m + m]) for r in range(order) for s in range(order)}
    offsets = None if offset is None else np.einsum("iic->ic", belief[offset:, offset:-1])

    def propagate(dt: Array, more: Array | None) -> None:
        carry(rows, dt)
        carry(columns, dt)
        grow(blocks, order, q if more is None else q * more, dt)
        if offsets is not None:
            offsets[:] += walk * dt

    return propagate
