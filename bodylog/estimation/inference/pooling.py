"""Encoder readings between two instants, pooled exactly, so that a scan takes one step for all of them.

Given the state at an instant, joints know nothing of each other until the next picture. What one joint's readings say
in between is a single element (A, b, C, η, J) of Särkkä & García-Fernández (2021, "Temporal parallelization of
Bayesian smoothers"): here the η, J part is written as two readings of the state before.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from .filter_records import Dynamics, Pooled
from .folds import Fold

MOST = 24
"""Instants pooled into one at most."""
LOUD = 4.0
"""Robust standard deviations of the readings' bends beyond which a reading is heard by itself, for the gate's sake."""
SINGULAR = 1e-12
"""Share of the rate's information below which it is rounding."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Instants pooled before each kept one: dt (S+1,B) s up to each and to the end · said, var (S,B,M), NaN if none."""

    dt: Array
    said: Array
    var: Array


def loud(said: Array) -> Array:
    """Which instants (E,) have a reading (E,M) so far from its neighbours' line that the gate may weigh it less."""
    found = np.zeros(len(said), bool)
    for column in said.T:
        known = np.flatnonzero(np.isfinite(column))
        bend = np.abs(np.diff(column[known], 2))
        if bend.any():
            found[known[1:-1][bend > LOUD * 1.4826 * np.median(bend[bend > 0])]] = True
    return found


def kept(wanted: Array) -> Array:
    """Instants (B,) that stay: those wanted (E,) bool, the last one, and enough that no more than MOST are pooled."""
    events = np.arange(len(wanted))
    since = events - np.maximum.accumulate(np.where(wanted, events, -1))
    return np.flatnonzero(wanted | (since % (MOST + 1) == 0) | (events == len(wanted) - 1))


def blocks(t: Array, said: Array, var: Array, kept: Array, alone: Array) -> Blocks:
    """What is heard up to kept instants (B,), but for those `alone` (E,): times t (E,), readings (E,M), variances."""
    events = np.flatnonzero(np.isfinite(said).any(axis=1) & ~alone)
    block = np.searchsorted(kept, events)
    place = np.arange(len(events)) - np.searchsorted(block, block)
    most = int(place.max(initial=-1)) + 1
    shape = (most, len(kept), said.shape[1])
    heard, noise = np.full(shape, np.nan), np.ones(shape)
    heard[place, block], noise[place, block] = said[events], var[events]
    begin = np.concatenate([t[:1], t[kept[:-1]]])
    times = np.tile(begin, (most + 2, 1))
    times[1 + place, block], times[-1] = t[events], t[kept]
    return Blocks(np.diff(np.maximum.accumulate(times, axis=0), axis=0), heard, noise)


def pooled(told: Blocks, dynamics: Dynamics, fold: Fold, more: Array | None = None) -> Pooled:
    """The blocks as a scan reads them; process variances (M,), or (M,G) of candidates that are laid side by side.

    In each block they are `more` (B,M) times as large, where that is given.
    """
    m = len(dynamics.process)
    levels, which = _levels(dynamics.process.reshape(m, -1))
    process = levels[:, :, None] if more is None else levels[:, :, None] * more.T[:, None]
    shape = (dynamics.size // m, *levels.shape, told.dt.shape[1])
    move, shift, noise = np.zeros((shape[0], *shape)), np.zeros(shape), np.zeros((shape[0], *shape))
    np.einsum("ss...->s...", move)[:] = 1.0
    word, nats = np.zeros((5, *shape[1:])), np.zeros(shape[1:])
    for said, var, dt in zip(told.said, told.var, told.dt[:-1], strict=True):
        _carry(move, shift, noise, dt, process, dynamics.drift)
        _hear(move, shift, noise, word, nats, said.T[:, None], var.T[:, None])
    _carry(move, shift, noise, told.dt[-1], process, dynamics.drift)
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
    """The different values (M,U) among each joint's candidates (M,G), and which of them (M,G) each is."""
    found = [np.unique(row, return_inverse=True) for row in process]
    most = max(len(values) for values, _ in found)
    return np.stack([np.pad(v, (0, most - len(v)), "edge") for v, _ in found]), np.stack([w for _, w in found])


def _carry(move: Array, shift: Array, noise: Array, dt: Array, process: Array, drift: Array | None) -> None:
    """The elements, dt (B,) later, in place; process variances (M,G,B) or (M,G,1)."""
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


def _hear(move: Array, shift: Array, noise: Array, word: Array, nats: Array, said: Array, var: Array) -> None:
    """One more reading (M,1,B) of each element, in place; word: J_xx, J_xv, J_vv, η_x, η_v (5,M,G,B)."""
    heard = np.isfinite(said)
    slope, mean, reach = (part[0] + part[2] if len(part) > 2 else part[0].copy() for part in (move, shift, noise))
    s = (reach[0] + reach[2] if len(reach) > 2 else reach[0]) + var
    weight, nu = heard / s, np.where(heard, said - mean, 0.0)
    x, v = slope[0] * weight, slope[1] * weight
    word += np.stack([x * slope[0], x * slope[1], v * slope[1], x * nu, v * nu])
    nats += 0.5 * (nu * nu * weight + np.log(np.where(heard, 2.0 * np.pi * s, 1.0)))
    gain = reach * weight
    move -= gain[:, None] * slope
    shift += gain * nu
    noise -= gain[:, None] * reach


def _as_readings(word: Array) -> tuple[Array, Array, Array, Array]:
    """y, var (2,M,G,B) and lean (M,G,B) of two readings that say J, η: J = Uᵀ D U; and what their nats lack."""
    xx, xv, vv, x, v = word
    lean = np.divide(xv, xx, out=np.zeros_like(xx), where=xx > 0)
    rest = vv - lean * xv
    d, e = np.stack([xx, np.where(rest > SINGULAR * vv, rest, 0.0)]), np.stack([x, v - lean * x])
    known = d > 0
    var = np.divide(1.0, d, out=np.full_like(d, np.inf), where=known)
    y = np.multiply(e, var, out=np.zeros_like(d), where=known)
    left = np.where(known, e * y + np.log(2.0 * np.pi / np.where(known, d, 1.0)), 0.0)
    return y, var, lean, -0.5 * left.sum(axis=0)
