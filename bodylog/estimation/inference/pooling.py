"""Encoder readings between two instants, pooled exactly, so that a scan takes one step for all of them.

Given the state at an instant, joints are independent until the next image. One joint's readings in between form a
single element (A, b, C, η, J) of Särkkä & García-Fernández (2021, "Temporal parallelization of Bayesian smoothers").
Here the η, J part is written as two readings of the state before.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from .filter_records import Dynamics, Pooled
from .folds import Fold

MOST = 24
"""Most instants pooled into one."""
LOUD = 4.0
"""Robust standard deviations of second differences; a reading beyond is not pooled, so that the gate applies."""
SINGULAR = 1e-12
"""Share of the rate's information below which it is rounding."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Instants pooled before each knot: dt (S+1,B) s up to each and to the end · y, var (S,B,M), NaN if none."""

    dt: Array
    y: Array
    var: Array


def outlier_candidates(y: Array) -> Array:
    """Instants (E,) with a reading (E,M) so far from its neighbours' line that the gate may reject it."""
    found = np.zeros(len(y), bool)
    for column in y.T:
        known = np.flatnonzero(np.isfinite(column))
        bend = np.abs(np.diff(column[known], 2))
        if bend.any():
            found[known[1:-1][bend > LOUD * 1.4826 * np.median(bend[bend > 0])]] = True
    return found


def kept(wanted: Array) -> Array:
    """Instants (B,) that become knots: those wanted (E,) bool, the last, and enough that at most MOST are pooled."""
    events = np.arange(len(wanted))
    since = events - np.maximum.accumulate(np.where(wanted, events, -1))
    return np.flatnonzero(wanted | (since % (MOST + 1) == 0) | (events == len(wanted) - 1))


def blocks(t: Array, y: Array, var: Array, kept: Array, alone: Array) -> Blocks:
    """Readings up to knots (B,), except those `alone` (E,): times t (E,), readings (E,M), variances."""
    events = np.flatnonzero(np.isfinite(y).any(axis=1) & ~alone)
    block = np.searchsorted(kept, events)
    place = np.arange(len(events)) - np.searchsorted(block, block)
    most = int(place.max(initial=-1)) + 1
    shape = (most, len(kept), y.shape[1])
    present, noise = np.full(shape, np.nan), np.ones(shape)
    present[place, block], noise[place, block] = y[events], var[events]
    begin = np.concatenate([t[:1], t[kept[:-1]]])
    times = np.tile(begin, (most + 2, 1))
    times[1 + place, block], times[-1] = t[events], t[kept]
    return Blocks(np.diff(np.maximum.accumulate(times, axis=0), axis=0), present, noise)


def pooled(between: Blocks, dynamics: Dynamics, fold: Fold, more: Array | None = None) -> Pooled:
    """The blocks as inputs of a scan; process variances (M,), or (M,G) of candidates side by side.

    `more` (B,M): factor on the process variance in each block, if given.
    """
    m = len(dynamics.process)
    levels, which = _levels(dynamics.process.reshape(m, -1))
    process = levels[:, :, None] if more is None else levels[:, :, None] * more.T[:, None]
    shape = (dynamics.size // m, *levels.shape, between.dt.shape[1])
    move, shift, noise = np.zeros((shape[0], *shape)), np.zeros(shape), np.zeros((shape[0], *shape))
    np.einsum("ss...->s...", move)[:] = 1.0
    word, nats = np.zeros((5, *shape[1:])), np.zeros(shape[1:])
    for y, var, dt in zip(between.y, between.var, between.dt[:-1], strict=True):
        _carry(move, shift, noise, dt, process, dynamics.drift)
        _condition(move, shift, noise, word, nats, y.T[:, None], var.T[:, None])
    _carry(move, shift, noise, between.dt[-1], process, dynamics.drift)
    y, var, lean, left = _as_readings(word)
    counted = 1.0 if dynamics.is_prior is None else ~dynamics.is_prior[:, None, None]

    def folded(a: Array, fill: float | Array = 0.0) -> Array:
        laid = fold.fold(np.moveaxis(a, -1, 0), fill)[..., np.arange(m)[:, None], which, :]
        return np.ascontiguousarray(np.swapaxes(laid, -1, -2)).reshape(*laid.shape[:-2], -1)

    still = np.eye(shape[0])[:, :, None, None]
    return Pooled(
        folded(y), folded(var, np.inf), folded(lean), folded(move, still), folded(shift), folded(noise),
        folded((nats + left) * counted).sum(axis=1),
    )  # fmt: skip


def _levels(process: Array) -> tuple[Array, Array]:
    """Distinct values (M,U) of each joint's candidates (M,G), and the index (M,G) of each."""
    found = [np.unique(row, return_inverse=True) for row in process]
    most = max(len(values) for values, _ in found)
    return np.stack([np.pad(v, (0, most - len(v)), "edge") for v, _ in found]), np.stack([w for _, w in found])


def _carry(move: Array, shift: Array, noise: Array, dt: Array, process: Array, drift: Array | None) -> None:
    """Move the elements by dt (B,), in place; process variances (M,G,B) or (M,G,1)."""
    move[0] += dt * move[1]
    shift[0] += dt * shift[1]
    noise[0] += dt * noise[1]
    noise[:, 0] += dt * noise[:, 1]
    grown = process * dt
    noise[0, 0] += grown * dt * dt / 3.0
    noise[0, 1] += 0.5 * dt * grown
    noise[1, 0] += 0.5 * dt * grown
    noise[1, 1] += grown
    if drift is not None:
        noise[2, 2] += drift.reshape(len(drift), -1, 1) * dt


def _condition(move: Array, shift: Array, noise: Array, word: Array, nats: Array, y: Array, var: Array) -> None:
    """Add one reading (M,1,B) to each element, in place; word: J_xx, J_xv, J_vv, η_x, η_v (5,M,G,B)."""
    present = np.isfinite(y)
    slope, mean, reach = (part[0] + part[2] if len(part) > 2 else part[0].copy() for part in (move, shift, noise))
    s = (reach[0] + reach[2] if len(reach) > 2 else reach[0]) + var
    weight, nu = present / s, np.where(present, y - mean, 0.0)
    x, v = slope[0] * weight, slope[1] * weight
    word += np.stack([x * slope[0], x * slope[1], v * slope[1], x * nu, v * nu])
    nats += 0.5 * (nu * nu * weight + np.log(np.where(present, 2.0 * np.pi * s, 1.0)))
    gain = reach * weight
    move -= gain[:, None] * slope
    shift += gain * nu
    noise -= gain[:, None] * reach


def _as_readings(word: Array) -> tuple[Array, Array, Array, Array]:
    """y, var (2,M,G,B) and lean (M,G,B) of two readings equivalent to J, η: J = Uᵀ D U; nats not in them."""
    xx, xv, vv, x, v = word
    lean = np.divide(xv, xx, out=np.zeros_like(xx), where=xx > 0)
    rest = vv - lean * xv
    d, e = np.stack([xx, np.where(rest > SINGULAR * vv, rest, 0.0)]), np.stack([x, v - lean * x])
    known = d > 0
    var = np.divide(1.0, d, out=np.full_like(d, np.inf), where=known)
    y = np.multiply(e, var, out=np.zeros_like(d), where=known)
    left = np.where(known, e * y + np.log(2.0 * np.pi / np.where(known, d, 1.0)), 0.0)
    return y, var, lean, -0.5 * left.sum(axis=0)
