"""Condition beliefs on the measurements of one instant, in many stretches of a log at once.

A belief is one array (K,K+1,C): the rows of the covariance, each followed by the mean. The product of a row h with it
is P Hᵀ and the predicted reading, so both are updated at once.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...types import Array
from .filter_records import GATE, PAIRS

if TYPE_CHECKING:
    from .filter_records import Dynamics, Pooled, Readings

MANY = 0.6
"""Share of stretches above which all are updated in place instead of copying some out and back."""
FLAT = 1.0
"""Nats from the gate's ½ GATE² to an outlier's cost anywhere: one in a hundred in an image of 320×240 px costs 14."""


class AdjointRecord(NamedTuple):
    """Per row: gains (rows,K,C) if requested, weights and innovations (rows,C)."""

    gains: Array | None
    weights: Array
    nus: Array

    def at(self, which: int | slice) -> "AdjointRecord":
        """The record of one instant, or of some rows."""
        return AdjointRecord(None if self.gains is None else self.gains[which], self.weights[which], self.nus[which])


class Rows(NamedTuple):
    """Readings y, 0 where silent · variances · present: 1 where there is a reading, else 0; (…,C) each."""

    y: Array
    var: Array
    present: Array

    @staticmethod
    def of(y: Array, var: Array) -> "Rows":
        """From readings that are NaN where silent."""
        present = np.isfinite(y)
        return Rows(np.where(present, y, 0.0), var, present.astype(float))

    def at(self, i: int, seen: Array | None = None) -> "Rows":
        """The rows of one instant, optionally of the stretches `seen` only."""
        return Rows(*(part[i] if seen is None else part[i].take(seen, axis=-1) for part in self))


def update(
    readings: "Readings", measured: tuple[Rows, Rows], i: int, seen: Array, dynamics: "Dynamics", belief: Array,
    encoder_d: Array, back: AdjointRecord, more: Array,
) -> None:  # fmt: skip
    """Condition the belief in place on all measurements of instant i; tracks only in the stretches `seen`.

    Noise is gated by the prior, so the result does not depend on the order. `measured`: encoders and tracks. more (C,)
    receives `outlier_cost`.
    """
    encoders, tracks = measured
    m, projected = encoders.y.shape[1], encoders.at(i)
    spoken = bool(projected.present.any())
    if spoken:
        var, encoder_d[:] = _gated_encoders(readings.encoders[i], projected.var, readings.gate, dynamics, belief)
        more += outlier_cost(encoder_d * encoder_d, gate=readings.gate).sum(axis=0)
    else:
        encoder_d[:] = np.nan
    if len(seen):
        _condition_tracks(tracks, readings, i, seen, belief, back.at(slice(m, None)), more)
    if spoken:
        _condition_encoders(projected._replace(var=var), belief, back.at(slice(m)), dynamics.offset)


def _condition_encoders(measured: Rows, belief: Array, back: AdjointRecord, offset: int | None) -> None:
    """Condition the belief in place on the encoders' rows (M,C)."""
    projected = np.empty((len(measured.y), *belief.shape[1:]))
    for j, ph in enumerate(projected):
        ph[:] = belief[j]
        if offset is not None:
            ph += belief[offset + j]
        s = ph[j] + measured.var[j]
        if offset is not None:
            s += ph[offset + j]
        np.divide(measured.present[j], s, out=back.weights[j])
        ph[-1] -= measured.y[j]
        _condition(belief, ph, back, j)
    np.negative(projected[:, -1], out=back.nus)


def condition_pooled(
    pooled: "Pooled", i: int, belief: Array, back: AdjointRecord, left: Array | None, offset: int | None
) -> None:
    """Condition the belief in place on the readings pooled before instant i, ungated, and move it to that instant.

    `left` (K,K+1,C) receives the belief before the move.
    """
    lean, (y, var) = pooled.lean[i], (pooled.y[i], pooled.var[i])
    order, m, _ = y.shape
    projected = np.empty((order * m, *belief.shape[1:]))
    for row, ph in enumerate(projected):
        state, j = divmod(row, m)
        ph[:] = belief[row]
        for pair, (low, high) in enumerate(PAIRS[order]):
            if low == state:
                ph += lean[pair, j] * belief[high * m + j]
        own = state == 0 and offset is not None
        if own:
            ph += belief[offset + j]
        s = ph[row] + var[state, j]
        for pair, (low, high) in enumerate(PAIRS[order]):
            if low == state:
                s += lean[pair, j] * ph[high * m + j]
        if own:
            s += ph[offset + j]
        np.divide(1.0, s, out=back.weights[row])
        ph[-1] -= y[state, j]
        _condition(belief, ph, back, row)
    np.negative(projected[:, -1], out=back.nus)
    if left is not None:
        left[:] = belief
    advance(pooled.move[i], pooled.shift[i], pooled.noise[i], belief)


def _condition(belief: Array, ph: Array, back: AdjointRecord, row: int) -> None:
    """Condition on one scalar reading: ph (K+1,C) is P Hᵀ followed by minus the innovation; `back` has its weight."""
    gain = np.multiply(ph[:-1], back.weights[row], out=None if back.gains is None else back.gains[row])
    belief -= gain[:, None] * ph


def advance(move: Array, shift: Array, noise: Array, belief: Array) -> None:
    """Move the belief in place by move (S,S,M,C) and shift (S,M,C) of each joint's states."""
    states, m, c = shift.shape
    k = states * m
    half = np.einsum("abjc,bjkc->ajkc", move, belief.reshape(states, m, k + 1, c))
    p = belief[:, :-1].reshape(k, states, m, c)
    np.einsum("abjc,kbjc->kajc", move, half.reshape(k, k + 1, c)[:, :-1].reshape(k, states, m, c), out=p)
    np.einsum("ajbjc->abjc", p.reshape(states, m, states, m, c))[:] += noise
    np.add(half[:, :, -1], shift, out=belief[:, -1].reshape(states, m, c))


def _condition_tracks(
    measured: Rows, readings: "Readings", i: int, seen: Array, belief: Array, back: AdjointRecord, more: Array
) -> None:  # fmt: skip
    """Condition the belief in place on the tracks' rows of instant i, in the stretches `seen` only if these are few."""
    jac, gate = readings.jac[i], readings.gate
    if len(seen) > MANY * belief.shape[-1]:
        more += _condition_track_rows(measured.at(i), jac, gate, belief, back)
        return
    some, rows = belief.take(seen, axis=-1), len(back.nus)
    part = AdjointRecord(
        None if back.gains is None else np.empty((rows, *some[:, -1].shape)), *np.empty((2, rows, len(seen)))
    )
    more[seen] += _condition_track_rows(measured.at(i, seen), jac.take(seen, axis=-1), gate, some, part)
    belief[..., seen] = some
    for whole, found in zip(back, part, strict=True):
        if whole is not None:
            whole[..., seen] = found


def _condition_track_rows(measured: Rows, jac: Array, gate: float, belief: Array, back: AdjointRecord) -> Array:
    """Condition the belief in place on tracks' rows (T,D,C), jac (T,D,M,C), gated by the prior; `outlier_cost` (C,)."""
    size, predicted = jac.shape[1], [_project(h, belief) for h in jac]
    own = [_gated(gate, *projected, *rows) for projected, *rows in zip(predicted, *measured, strict=True)]
    for t, (h, y, present, (var, _)) in enumerate(zip(jac, measured.y, measured.present, own, strict=True)):
        # earlier tracks have moved the belief
        ph, s = predicted[0] if t == 0 else _project(h, belief)
        rows = back.at(slice(size * t, size * t + size))
        ph[:, -1] -= y
        ph[:, -1] *= present
        for d in range(size):
            np.divide(present[d], s[d, d] + var[d], out=rows.weights[d])
            for e in range(d + 1, size):
                share = rows.weights[d] * s[d, e]
                ph[e] -= share * ph[d]
                s[e, e:] -= share * s[d, e:]
        np.negative(ph[:, -1], out=rows.nus)
        gains = np.multiply(ph[:, :-1], rows.weights[:, None], out=rows.gains)
        belief -= np.einsum("dkc,dlc->klc", gains, ph)
    return np.asarray(sum(cost for _, cost in own))


def _project(h: Array, belief: Array) -> tuple[Array, Array]:
    """H times the belief (D,K+1,C), and H P Hᵀ (D,D,C), for rows h (D,M,C)."""
    m = h.shape[1]
    projected = np.einsum("dmc,mkc->dkc", h, belief[:m])
    return projected, np.einsum("emc,dmc->dec", h, projected[:, :m])


def _gated(gate: float, projected: Array, s: Array, y: Array, var: Array, present: Array) -> tuple[Array, Array]:
    """Gated variances (D,C) and `outlier_cost` (C,) of a track; projected (D,K+1,C) and s (D,D,C) are by the prior."""
    total, nu = np.einsum("ddc->dc", s) + var, (y - projected[:, -1]) * present
    d2, size = mahalanobis(nu, total, s)
    inflated = raised(var, total, d2, gate)
    if inflated is var:
        return var, np.zeros(d2.shape)
    square, whole = mahalanobis(nu, total + (inflated - var), s)
    return inflated, outlier_cost(d2, square, np.log(whole / size))


def mahalanobis(nu: Array, total: Array, s: Array) -> tuple[Array, Array]:
    """Square of innovations nu (D,C) over variances total (D,C) and covariances s (D,D,C); the determinant (C,)."""
    off, var, cross = list(nu), list(total), [list(row) for row in s]
    square, size = off[0] * off[0] / var[0], var[0]
    for e in range(1, len(off)):
        for d in range(e):
            share = cross[d][e] / var[d]
            off[e], var[e] = off[e] - share * off[d], var[e] - share * cross[d][e]
            for f in range(e + 1, len(off)):
                cross[e][f] = cross[e][f] - share * cross[d][f]
        square, size = square + off[e] * off[e] / var[e], size * var[e]
    return square, size


def _gated_encoders(y: Array, var: Array, gate: float, dynamics: "Dynamics", belief: Array) -> tuple[Array, Array]:
    """Gated encoder variances (M,C), and innovations of y (M,C) in standard deviations, NaN if silent."""
    m, diagonal, offset = len(y), np.einsum("iic->ic", belief[:, :-1]), dynamics.offset
    total, nu = diagonal[:m] + var, y - belief[:m, -1]
    if offset is not None:
        total += diagonal[offset:] + 2.0 * np.einsum("iic->ic", belief[:m, offset:-1])
        nu -= belief[offset:, -1]
    np.maximum(total, var, out=total)  # rounding takes a variance below 0 after a reading far surer than the belief
    d = nu / np.sqrt(total)
    if dynamics.is_prior is not None:
        d[dynamics.is_prior] = np.nan
    return raised(var, total, d * d, gate), d


def raised(var: Array, total: Array, d2: Array, gate: float = GATE) -> Array:
    """Noise `var` for innovations of variance `total`, inflated by (d/gate)⁴ − 1 totals outside the gate."""
    over = d2 > gate * gate
    return var + total * np.where(over, (d2 / (gate * gate)) ** 2 - 1.0, 0.0) if over.any() else var


def outlier_cost(d2: Array, inflated: Array | None = None, logs: Array | None = None, gate: float = GATE) -> Array:
    """Nats that innovations of squares d2 cost beyond a Gaussian of the inflated noise; 0 inside the gate.

    The whole cost is that of a density that hardly falls any more outside the gate: it grows with distance. inflated:
    their squares with the inflated noise · logs: logarithm of the ratio of the variances' determinants. Both follow
    from d2 for single readings.
    """
    over = d2 / (gate * gate)
    if not (over > 1.0).any():
        return np.zeros(over.shape)
    over = np.fmax(over, 1.0)
    own = GATE * GATE / over if inflated is None else inflated
    cost = 0.5 * GATE * GATE + FLAT * (1.0 - 1.0 / over) - 0.5 * own - (np.log(over) if logs is None else 0.5 * logs)
    return np.where(over > 1.0, cost, 0.0)
