"""The way back over a filtered log, in Bryson and Frazier's form: the filter's gains, but no inverse."""

import numpy as np

from ..types import Array
from .conditioning import MANY
from .scan import EVEN, Leaps, Pooled, Readings, Trace


def means(trace: Trace, after: Array) -> Array:
    """Smoothed state (L,K,C) from the adjoints `after` (L,K,C) each instant."""
    return np.asarray(trace.z - np.einsum("iklc,ilc->ikc", trace.p, after))


def adjoints(readings: Readings, trace: Trace, end: Array) -> tuple[Array, Array]:
    """Adjoints (L,K,C) after each instant and (K,C) before all, from that at the `end` (K,C)."""
    assert trace.back is not None
    gains, weights, nus = trace.back
    adjoint, after, m = end.copy(), np.empty_like(trace.z), readings.encoders.shape[1]
    jac = readings.jac.reshape(len(after), -1, m, end.shape[1])
    push, heard = nus * weights, _heard(trace, m, m + jac.shape[1])
    for i in range(len(after) - 1, -1, -1):
        after[i] = adjoint
        for row in heard[i]:
            pull = np.einsum("kc,kc->c", gains[i, row], adjoint) + push[i, row]
            if row < m:
                adjoint[row :: 2 * m] -= pull  # angle and, where there is one, offset
            else:
                adjoint[:m] -= jac[i, row - m] * pull
        if isinstance(readings, Leaps):
            _unleap(readings.pooled, i, adjoint, gains[i, -2 * m :], push[i, -2 * m :])
        else:
            adjoint[m : 2 * m] += readings.dt[i] * adjoint[:m]
    return after, adjoint


def _unleap(pooled: Pooled, i: int, adjoint: Array, gains: Array, push: Array) -> None:
    """Carry the adjoint (K,C) back over what was pooled before instant i."""
    lean, parts = pooled.lean[i], adjoint.reshape(*pooled.shift[i].shape)
    parts[:] = np.einsum("abjc,ajc->bjc", pooled.move[i], parts)
    m = len(lean)
    for row in range(2 * m - 1, -1, -1):
        pull = np.einsum("kc,kc->c", gains[row], adjoint) + push[row]
        of_rate, j = divmod(row, m)
        if of_rate:
            parts[1, j] -= pull
        else:
            parts[::2, j] -= pull
            parts[1, j] -= lean[j] * pull


def covariances(readings: Readings, trace: Trace, end: Array, into: Array | None = None) -> Array:
    """The adjoint's information (K,K,C) before all from that at the `end`; `into` takes smoothed angles' (L,M,M,C)."""
    length, m, _ = readings.encoders.shape
    information = end.copy()
    heard = _heard(trace, m, m + readings.y.shape[1] * readings.y.shape[2])
    for i in range(length - 1, -1, -1):
        p, dt = trace.p[i], readings.dt[i]
        if into is not None:
            half = np.einsum("jkc,klc->jlc", p[:m], information)
            np.subtract(p[:m, :m], np.einsum("jlc,lkc->jkc", half, p[:, :m]), out=into[i])
        _unhear(readings, trace, i, heard[i], information)
        information[m : 2 * m] += dt * information[:m]
        information[:, m : 2 * m] += dt * information[:, :m]
        if i % EVEN == 0:
            information[:] = 0.5 * (information + information.transpose(1, 0, 2))
    return information


def _unhear(readings: Readings, trace: Trace, i: int, rows: list[int], information: Array) -> None:
    """Carry the information (K,K,C) back over the rows heard at instant i, last heard first."""
    assert trace.back is not None
    gains, weights, _ = (part[i] for part in trace.back)
    m = readings.encoders.shape[1]
    tracks = [row for row in rows if row >= m]
    for row in rows[: len(rows) - len(tracks)]:
        b, curve = _said(information, gains[row], weights[row])
        information[row :: 2 * m] -= b
        information[:, row :: 2 * m] -= b[:, None]
        information[row :: 2 * m, row :: 2 * m] += curve
    seen = np.flatnonzero(weights[m:].any(axis=0)) if tracks else np.empty(0, int)
    few = len(seen) < MANY * information.shape[2]
    some, jac = (part.take(seen, axis=-1) if few else part for part in (information, readings.jac[i]))
    for row in tracks:
        gain, weight = (part[row].take(seen, axis=-1) if few else part[row] for part in (gains, weights))
        h, (b, curve) = jac.reshape(-1, m, jac.shape[-1])[row - m], _said(some, gain, weight)
        some[:m] -= h[:, None] * b[None]
        some[:, :m] -= b[:, None] * h[None]
        some[:m, :m] += (h * curve)[:, None] * h[None]
    if few:
        information[..., seen] = some


def _said(information: Array, gain: Array, weight: Array) -> tuple[Array, Array]:
    """Information times the gain (K,C), and what both and the weight make of the reading's own (C,)."""
    b = np.einsum("klc,lc->kc", information, gain)
    return b, np.einsum("kc,kc->c", gain, b) + weight


def _heard(trace: Trace, m: int, rows: int) -> list[list[int]]:
    """Rows that some stretch hears, by instant, last heard first: m encoders are heard after the tracks."""
    assert trace.back is not None
    heard: Array = np.any(trace.back[1], axis=2)
    order = [*range(m - 1, -1, -1), *range(rows - 1, m - 1, -1)]
    return [[row for row in order if said[row]] for said in heard]


def before(at_start: Array) -> Array:
    """Ends (…,C) for the next round: each stretch ends where its successor began; nothing comes after the last."""
    ends = np.zeros_like(at_start)
    ends[..., :-1] = at_start[..., 1:]
    return ends
