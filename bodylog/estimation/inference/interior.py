"""Beliefs at every instant, from those at the knots: forward through all intervals, or between both ends."""

from dataclasses import dataclass, fields

import numpy as np

from ...types import Array
from .banded import CHUNK, joints_apart
from .bridge import Bridge, Slots
from .motion_model import MotionModel
from .small import product, spd_inverse


@dataclass(frozen=True, eq=False)
class Forward:
    """Each slot's state (L,M,S,B) and angles' covariance (L,M,M,B), before its readings and after; nats (L,B).

    innovation, total (L,M,B): each encoder's, with its variance, NaN where silent · offset_var (L,M,B): of its offset.
    """

    prior: Array
    prior_cov: Array
    state: Array
    cov: Array
    nats: Array
    innovation: Array
    total: Array
    offset_var: Array


def forward(motion: MotionModel, slots: Slots, mean: Array, cov: Array) -> Forward:
    """Filter all intervals from the knots before them: mean (K,B), cov (K,K,B), given the measurements up to there."""
    parts = [
        _forward(motion, slots.part(some), mean[:, some], cov[..., some])
        for some in (slice(begin, begin + CHUNK) for begin in range(0, mean.shape[1], CHUNK))
    ]
    whole = {one.name: np.concatenate([getattr(part, one.name) for part in parts], axis=-1) for one in fields(Forward)}
    return Forward(**whole)


def _forward(motion: MotionModel, slots: Slots, mean: Array, cov: Array) -> Forward:
    """Filter some intervals."""
    (length, m, b), s = slots.encoders.shape, motion.states
    # one array of covariance and, last in each row, mean: P Hᵀ and the predictions H x are one product
    belief, k = np.concatenate([cov, mean[:, None]], axis=1), m * s
    rows, columns = belief.reshape(m, s, -1, b), belief[:, :k].reshape(k, m, s, b)
    alone, angles = joints_apart(belief[:, :k], s), slice(0, k, s)
    prior, state = np.empty((2, length, m, s, b))
    prior_cov, own = np.empty((2, length, m, m, b))
    nats, (innovation, total, offset_var) = np.zeros((length, b)), np.full((3, length, m, b), np.nan)
    for i, dt in enumerate(slots.dt):
        motion.carry(rows.swapaxes(0, 1), dt)
        motion.carry(np.moveaxis(columns, 2, 0), dt)
        alone += motion.spread(dt)
        prior[i], prior_cov[i] = rows[:, :, -1], belief[angles, angles]
        nats[i], innovation[i], total[i] = condition_encoders(motion, belief, slots.encoders[i], slots.var[i])
        state[i], own[i], offset_var[i] = rows[:, :, -1], belief[angles, angles], alone[-1, -1]
    return Forward(prior, prior_cov, state, own, nats, innovation, total, offset_var)


def condition_encoders(motion: MotionModel, belief: Array, y: Array, var: Array) -> tuple[Array, Array, Array]:
    """Condition the belief (K,K+1,B) in place on encoders y (M,B), NaN where silent; nats (B,).

    Also innovations (M,B) by the belief before all of them, and their variances.
    """
    nats, spoken = np.zeros(y.shape[1]), np.isfinite(y).any(axis=1)
    if not spoken.any():
        return nats, np.full(y.shape, np.nan), np.full(y.shape, np.nan)
    reaches = [_reach(motion, belief, j) for j in range(len(y))]
    total = np.stack([_own(motion, reach, j) for j, reach in enumerate(reaches)]) + var
    innovation = y - np.stack([reach[-1] for reach in reaches])
    for j in np.flatnonzero(spoken):
        nats += _condition(motion, belief, int(j), y[j], var[j])
    return nats, innovation, np.where(np.isfinite(y), total, np.nan)


def _reach(motion: MotionModel, belief: Array, joint: int) -> Array:
    """P Hᵀ (K,B) followed by the prediction of one encoder."""
    first, s = joint * motion.states, motion.states
    return belief[first] if motion.walk is None else np.asarray(belief[first] + belief[first + s - 1])


def _own(motion: MotionModel, reach: Array, joint: int) -> Array:
    """H P Hᵀ (B,) from P Hᵀ (K+1,B)."""
    first, s = joint * motion.states, motion.states
    return reach[first] if motion.walk is None else np.asarray(reach[first] + reach[first + s - 1])


def _condition(motion: MotionModel, belief: Array, joint: int, y: Array, var: Array) -> Array:
    """Condition the belief in place on one encoder's readings y (B,); their nats (B,)."""
    spoken, reach = np.isfinite(y), _reach(motion, belief, joint).copy()
    total = _own(motion, reach, joint) + var
    weight, left = spoken / total, np.where(spoken, y - reach[-1], 0.0)
    gain = reach[:-1] * weight
    reach[-1] = -left
    belief -= gain[:, None] * reach[None]
    return np.asarray(0.5 * (left * left * weight + np.log(np.where(spoken, 2.0 * np.pi * total, 1.0))))


@dataclass(frozen=True, eq=False)
class Between:
    """Each slot's states from both ends: low (L,S,S,M,B) z + high z' + shift (L,S,M,B).

    rest (L,M,B): variance of the angle given both ends.
    """

    low: Array
    high: Array
    shift: Array
    rest: Array


def between(motion: MotionModel, slots: Slots, found: Bridge) -> Between:
    """Rauch–Tung–Striebel recursion within each interval, given the state at its beginning."""
    length, (s, _, m, b) = len(slots.dt), found.move.shape
    low, high, shift = np.zeros((length, s, s, m, b)), np.zeros((length, s, s, m, b)), np.zeros((length, s, m, b))
    rest, spread = np.zeros((length, m, b)), np.zeros((s, s, m, b))
    np.einsum("ssjb->sjb", high[-1])[:] = 1.0
    for i in range(length - 2, -1, -1):
        _, (move, given, noise) = found.prefix[i]
        (next_move, next_given, next_noise), _ = found.prefix[i + 1]
        leant = noise.copy()
        motion.carry(leant.swapaxes(0, 1), slots.dt[i + 1])
        gain = product(leant, spd_inverse(next_noise))
        low[i] = move + product(gain, low[i + 1] - next_move)
        high[i] = product(gain, high[i + 1])
        shift[i] = given + (gain * (shift[i + 1] - next_given)[None]).sum(axis=1)
        spread = noise + product(product(gain, spread - next_noise), gain.swapaxes(0, 1))
        rest[i] = spread[0, 0]
    return Between(low, high, shift, rest)


def smoothed(path: Between, mean: Array) -> Array:
    """Smoothed states (L,M,S,B) of the slots from those (M,S,B+1) of the knots."""
    low, high = (np.moveaxis(part, 0, 1) for part in (mean[..., :-1], mean[..., 1:]))
    found = np.einsum("labjk,bjk->ljak", path.low, low) + np.einsum("labjk,bjk->ljak", path.high, high)
    return np.asarray(found + path.shift.swapaxes(1, 2))


def smoothed_cov(path: Between, own: Array, across: Array) -> Array:
    """Smoothed covariances (L,M,M,B) of angles from those of the knots (M,S,M,S,B+1) and across (M,S,M,S,B)."""
    low, high = path.low[:, 0], path.high[:, 0]
    length, _, m, b = low.shape
    found = np.zeros((length, m, m, b))
    for i in range(length):
        left = np.einsum("ajk,jabck->jbck", low[i], own[..., :-1])
        found[i] = np.einsum("jbck,cbk->jbk", left, low[i])
        cross = np.einsum("jbck,cbk->jbk", np.einsum("ajk,jabck->jbck", low[i], across), high[i])
        found[i] += cross + cross.swapaxes(0, 1)
        found[i] += np.einsum("jbck,cbk->jbk", np.einsum("ajk,jabck->jbck", high[i], own[..., 1:]), high[i])
    np.einsum("ljjk->ljk", found)[:] += path.rest
    return found
