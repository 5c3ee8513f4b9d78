"""Encoder readings between two instants, pooled exactly, so that a scan takes one step for all of them.

Given the state at an instant, joints are independent until the next image. One joint's readings in between form a
single element (A, b, C, η, J) of Särkkä & García-Fernández (2021, "Temporal parallelization of Bayesian smoothers").
Here the η, J part is written as readings of the state before.
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from .filter_records import PAIRS, Dynamics, Pooled
from .folds import Fold
from .motion import carry, grow

MOST = 24
"""Most instants pooled into one."""
LOUD = 4.0
"""Robust standard deviations of second differences; a reading beyond is not pooled, so that the gate applies."""
SINGULAR = 1e-12
"""Share of a derivative's information below which it is rounding."""


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


def pooled(
    between: Blocks, dynamics: Dynamics, fold: Fold, more: Array | None = None, held: Array | None = None
) -> Pooled:
    """The blocks as inputs of a scan; process variances (M,), or (M,G) of candidates side by side.

    `more` (B,M): factor on the process variance in each block, if given · held (B,M) bool: joints that keep to their
    stationary motion, in blocks without readings.
    """
    m = len(dynamics.process)
    levels, which = _levels(dynamics.process.reshape(m, -1))
    process = levels[:, :, None] if more is None else levels[:, :, None] * more.T[:, None]
    order, shape = dynamics.order, (dynamics.size // m, *levels.shape, between.dt.shape[1])
    move, shift, noise = np.zeros((shape[0], *shape)), np.zeros(shape), np.zeros((shape[0], *shape))
    np.einsum("ss...->s...", move)[:] = 1.0
    information, nats = np.zeros((order, order + 1, *shape[1:])), np.zeros(shape[1:])
    for y, var, dt in zip(between.y, between.var, between.dt[:-1], strict=True):
        _carry(move, shift, noise, dt, process, dynamics)
        _condition(move, shift, noise, information, nats, y.T[:, None], var.T[:, None])
    _carry(move, shift, noise, between.dt[-1], process, dynamics)
    if held is not None:
        _hold((move, shift, noise), between.dt[-1], dynamics, held)
    y, var, lean, left = _as_readings(information)
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


def _carry(move: Array, shift: Array, noise: Array, dt: Array, process: Array, dynamics: Dynamics) -> None:
    """Move the elements by dt (B,), in place; process variances (M,G,B) or (M,G,1)."""
    order = dynamics.order
    for part in (move[:order], shift[:order], noise[:order], noise[:, :order].swapaxes(0, 1)):
        carry(part, dt)
    grow(noise, order, process, dt)
    if dynamics.drift is not None:
        noise[order, order] += dynamics.drift.reshape(len(dynamics.drift), -1, 1) * dt


def _hold(parts: tuple[Array, Array, Array], dt: Array, dynamics: Dynamics, held: Array) -> None:
    """Let joints held (B,M) bool move by dt (B,) as a stationary process instead, in place; parts (…,M,G,B)."""
    assert dynamics.stationary is not None
    some, order = np.flatnonzero(held.any(axis=1)), dynamics.order
    for whole, step in zip(parts, dynamics.stationary.step(dt[some]), strict=True):
        own = whole[:order] if step.ndim == 3 else whole[:order, :order]
        own[..., some] = np.where(held[some].T[:, None], step[..., None, :], own[..., some])


def moves(dynamics: Dynamics, dt: Array, held: Array) -> tuple[Array, Array, Array]:
    """Move (E,S,S,M), shift (E,S,M), noise (E,S,S,M) within dt (E,) s; of joints held (E,M) as a stationary process."""
    states, process = dynamics.size // len(dynamics.process), dynamics.process[:, None]
    move, noise = np.zeros((2, states, states, *process.shape, len(dt)))
    shift = np.zeros(move.shape[1:])
    np.einsum("ss...->s...", move)[:] = 1.0
    _carry(move, shift, noise, dt, process[..., None], dynamics)
    _hold((move, shift, noise), dt, dynamics, held)
    move, shift, noise = (np.moveaxis(part[..., 0, :], -1, 0) for part in (move, shift, noise))
    return move, shift, noise


def _condition(move: Array, shift: Array, noise: Array, information: Array, nats: Array, y: Array, var: Array) -> None:
    """Add one reading (M,1,B) to each element, in place; information: J and η of the first states (O,O+1,M,G,B).

    An offset has the row of the angle in J and η.
    """
    present, order = np.isfinite(y), len(information)
    offset = len(move) > order
    slope, mean, reach = (part[0] + part[order] if offset else part[0].copy() for part in (move, shift, noise))
    s = (reach[0] + reach[order] if offset else reach[0]) + var
    weight, nu = present / s, np.where(present, y - mean, 0.0)
    for state, row in enumerate(information):
        own = slope[state] * weight
        for other in range(state, order):
            row[other] += own * slope[other]
        row[order] += own * nu
    nats += 0.5 * (nu * nu * weight + np.log(np.where(present, 2.0 * np.pi * s, 1.0)))
    gain = reach * weight
    move -= gain[:, None] * slope
    shift += gain * nu
    noise -= gain[:, None] * reach


def _as_readings(information: Array) -> tuple[Array, Array, Array, Array]:
    """y, var (O,M,G,B) and lean (P,M,G,B) of readings equivalent to J, η: J = Uᵀ D U; nats not in them."""
    order, rest = len(information), information.copy()
    y, var = np.zeros((2, order, *rest.shape[2:]))
    lean, left = np.zeros((len(PAIRS[order]), *rest.shape[2:])), np.zeros(rest.shape[2:])
    for state, row in enumerate(rest):
        known = row[state] > SINGULAR * information[state, state]
        var[state] = np.divide(1.0, row[state], out=np.full_like(left, np.inf), where=known)
        share = np.where(known, var[state], 0.0)
        y[state] = row[order] * share
        left += np.where(known, row[order] * y[state] + np.log(2.0 * np.pi * np.where(known, var[state], 1.0)), 0.0)
        for other in range(state + 1, order):
            own = lean[PAIRS[order].index((state, other))]
            np.multiply(row[other], share, out=own)
            rest[other, other:] -= own * row[other:]
    return y, var, lean, -0.5 * left
