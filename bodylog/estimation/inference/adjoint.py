"""Backward pass of the smoother in Bryson–Frazier form: it needs the filter's gains, and no inverse."""

import numpy as np

from ...types import Array
from .conditioning import MANY
from .filter_records import PAIRS, Dynamics, KnotReadings, Pooled, Readings
from .motion import carry_back
from .scan import EVEN, Trace


def means(trace: Trace, after: Array) -> Array:
    """Smoothed state (L,K,C) from the adjoints `after` (L,K,C) each instant."""
    return np.asarray(trace.z - np.einsum("iklc,ilc->ikc", trace.p, after))


def adjoints(readings: Readings, trace: Trace, end: Array, order: int) -> tuple[Array, Array]:
    """Adjoints (L,K,C) after each instant and (K,C) before the first, from the adjoint at the `end` (K,C).

    order: the motion's.
    """
    assert trace.back is not None
    gains, weights, nus = trace.back
    adjoint, after, m = end.copy(), np.empty_like(trace.z), readings.encoders.shape[1]
    jac = readings.jac.reshape(len(after), -1, m, end.shape[1])
    push, used = nus * weights, _used_rows(trace, m, m + jac.shape[1])
    for i in range(len(after) - 1, -1, -1):
        after[i] = adjoint
        for row in used[i]:
            pull = np.einsum("kc,kc->c", gains[i, row], adjoint) + push[i, row]
            if row < m:
                adjoint[row :: order * m] -= pull  # angle and, where there is one, offset
            else:
                adjoint[:m] -= jac[i, row - m] * pull
        if readings.reset is not None:
            adjoint *= _kept(readings.reset[i], len(adjoint), order)
        if isinstance(readings, KnotReadings):
            assert trace.left is not None
            _undo_pooled(readings.pooled, i, adjoint, trace.left[i])
        elif readings.moves is not None:
            _undo_move(readings.moves[0][i], adjoint[:, None])
        else:
            carry_back(adjoint[: order * m].reshape(order, m, -1), readings.dt[i])
    return after, adjoint


def _undo_move(move: Array, adjoints: Array) -> None:
    """Carry adjoints (K,…,C) back, in place, over the move (S,S,M,C) of each joint's states."""
    states, _, m, c = move.shape
    parts = adjoints.reshape(states, m, -1, c)
    adjoints[:] = np.einsum("abjc,aj...c->bj...c", move, parts).reshape(adjoints.shape)


def _kept(reset: Array, states: int, order: int) -> Array:
    """States (K,C) bool that survive a reset of joints `reset` (M,C); the adjoint of the others becomes zero."""
    keep, m = np.ones((states, reset.shape[1]), bool), len(reset)
    keep[: order * m] = np.tile(~reset, (order, 1))
    return keep


def _undo_pooled(pooled: Pooled, i: int, adjoint: Array, left: Array) -> None:
    """Carry the adjoint λ (K,C) back over the pooled readings before instant i; `left` is the belief before the move.

    Each reading y of the smoothed state z − P λ subtracts Hᵀ R⁻¹ (y − H (z − P λ)) from λ.
    """
    lean, parts = pooled.lean[i], adjoint.reshape(pooled.shift[i].shape)
    parts[:] = np.einsum("abjc,ajc->bjc", pooled.move[i], parts)
    smooth = (left[:, -1] - np.einsum("klc,lc->kc", left[:, :-1], adjoint)).reshape(parts.shape)
    order = len(pooled.y[i])
    lack = pooled.y[i] - smooth[:order]
    for own, (low, high) in zip(lean, PAIRS[order], strict=True):
        lack[low] -= own * smooth[high]
    if len(parts) > order:
        lack[0] -= smooth[order]
    lack /= pooled.var[i]
    parts[:order] -= lack
    for own, (low, high) in zip(lean, PAIRS[order], strict=True):
        parts[high] -= own * lack[low]
    if len(parts) > order:
        parts[order] -= lack[0]


def covariances(readings: Readings, trace: Trace, dynamics: Dynamics) -> Array:
    """Smoothed covariances (L,O,O,C) of the angles and, with offsets, of the sums of angle and offset: O = M or 2 M.

    The information Λ of everything after a stretch becomes W + Ψ Λ Ψᵀ at an earlier instant, where Ψ maps adjoints at
    the end back to that instant. The smoothed covariance is the one for Λ = 0 minus R Λ Rᵀ, with R = P Ψ.
    """
    (k, _, c), m, order = trace.p[0].shape, readings.encoders.shape[1], dynamics.order
    known, used = np.zeros((k, 2 * k, c)), _used_rows(trace, m, m + readings.y.shape[1] * readings.y.shape[2])
    np.einsum("kkc->kc", known[:, k:])[:] = 1.0
    size = m if dynamics.offset is None else 2 * m
    cov, reach = np.empty((len(trace.p), size, size, c)), np.empty((len(trace.p), size, k, c))
    for i in range(len(cov) - 1, -1, -1):
        rows, dt = _outputs(trace.p[i], m, dynamics.offset), readings.dt[i]
        half = np.einsum("jkc,klc->jlc", rows, known)
        own = _outputs(rows.swapaxes(0, 1), m, dynamics.offset).swapaxes(0, 1)
        np.subtract(own, np.einsum("jlc,klc->jkc", half[:, :k], rows), out=cov[i])
        reach[i] = half[:, k:]
        _undo_rows(readings, trace, i, used[i], known, order)
        if readings.reset is not None:
            keep = _kept(readings.reset[i], k, order)
            known *= keep[:, None]
            known[:, :k] *= keep
        if readings.moves is not None:
            _undo_move(readings.moves[0][i], known)
            _undo_move(readings.moves[0][i], known[:, :k].swapaxes(0, 1))
        else:
            carry_back(known[: order * m].reshape(order, m, 2 * k, c), dt)
            carry_back([known[:, state * m : state * m + m] for state in range(order)], dt)
        if i % EVEN[order] == 0:
            known[:, :k] = 0.5 * (known[:, :k] + known[:, :k].transpose(1, 0, 2))
    ends = _ends(known)
    for less, r in zip(cov, reach, strict=True):
        less -= np.einsum("jlc,mlc->jmc", np.einsum("jkc,klc->jlc", r, ends), r)
    return cov


def _outputs(p: Array, m: int, offset: int | None) -> Array:
    """Rows of p (K,…) for the m angles and, with offsets, for what the encoders read."""
    return p[:m] if offset is None else np.concatenate([p[:m], p[:m] + p[offset : offset + m]])


def _ends(at_start: Array) -> Array:
    """Information (K,K,C) of everything after each stretch, from its W and Ψ (K,2K,C); zero after the last stretch."""
    k, _, c = at_start.shape
    before, ends = np.moveaxis(at_start, -1, 0), np.zeros((c, k, k))
    for j in range(c - 1, 0, -1):
        own, across = before[j, :, :k], before[j, :, k:]
        ends[j - 1] = own + across @ ends[j] @ across.T
    return np.ascontiguousarray(np.moveaxis(ends, 0, -1))


def _undo_rows(readings: Readings, trace: Trace, i: int, rows: list[int], information: Array, order: int) -> None:
    """Carry W and Ψ (K,2K,C) back over the rows of instant i, in reverse order."""
    assert trace.back is not None
    gains, weights, _ = (part[i] for part in trace.back)
    k, m = len(information), readings.encoders.shape[1]
    tracks = [row for row in rows if row >= m]
    for row in rows[: len(rows) - len(tracks)]:
        _undo_encoder(information, slice(row, k, order * m), gains[row], weights[row], readings.encoder_var[i, row])
    seen = np.flatnonzero(weights[m:].any(axis=0)) if tracks else np.empty(0, int)
    few = len(seen) < MANY * information.shape[2]
    some, jac = (part.take(seen, axis=-1) if few else part for part in (information, readings.jac[i]))
    for row in tracks:
        gain, weight = (part[row].take(seen, axis=-1) if few else part[row] for part in (gains, weights))
        h, (b, curve) = jac.reshape(-1, m, jac.shape[-1])[row - m], _row_information(some, gain, weight)
        some[:m] -= h[:, None] * b[None]
        some[:, :m] -= b[:k, None] * h[None]
        some[:m, :m] += (h * curve)[:, None] * h[None]
    if few:
        information[..., seen] = some


def _undo_encoder(information: Array, own: slice, gain: Array, weight: Array, var: Array) -> None:
    """Carry W and Ψ (K,2K,C) back over one encoder: its `own` states are the angle and, where there is one, the offset.

    W becomes (I − g h)ᵀ W (I − g h) + weight hᵀh. Of an exact reading 1 − h g = R weight is far below rounding of h g,
    and W is as much larger, so this share is not taken from a difference.
    """
    left = np.maximum(1.0 - gain[own].sum(axis=0), var * weight)
    others = gain.copy()
    others[own] = 0.0
    for part in (information, information[:, : len(information)].swapaxes(0, 1)):
        some = part[own]
        found = left * some - np.einsum("kc,klc->lc", others, part)
        if len(some) > 1:
            found += np.einsum("hc,shlc->slc", gain[own], some[:, None] - some[None])
        part[own] = found
    information[own, own] += weight


def _row_information(information: Array, gain: Array, weight: Array) -> tuple[Array, Array]:
    """Gain times every column (…,C), and the row's own information (C,)."""
    b = np.einsum("klc,kc->lc", information, gain)
    return b, np.einsum("kc,kc->c", gain, b[: len(gain)]) + weight


def _used_rows(trace: Trace, m: int, rows: int) -> list[list[int]]:
    """Rows with a reading in some stretch, per instant and in reverse order: the m encoders come after the tracks."""
    assert trace.back is not None
    used: Array = np.any(trace.back[1], axis=2)
    order = [*range(m - 1, -1, -1), *range(rows - 1, m - 1, -1)]
    return [[row for row in order if flags[row]] for flags in used]


def before(at_start: Array) -> Array:
    """Ends (…,C) for the next round: each stretch ends with its successor's start, the last one with zero."""
    ends = np.zeros_like(at_start)
    ends[..., :-1] = at_start[..., 1:]
    return ends
