"""State against action: the delay with which the joints
follow what was asked of them, and by how far they miss it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..estimation.timing.delay_profile import fit_profile_peak, measure_jackknife_error
from ..logs.datasets.checks import value_ranges
from ..types import Array
from .reading import EpisodeReading, StoredNumbers
from .records import Measurement
from .siblings import pool_values

EARLIEST_S = -0.2
LATEST_S = 0.6
"""Delays of the state against the action that are searched."""
STEPS_PER_ROW = 4
"""Delays that are tried within one row's time: a parabola gives the rest."""
BLOCKS = 8
"""Blocks of time that are left out in turn, for the standard error."""
LEAST_CORRELATION = 0.7
"""Correlation of the steps of state and action at the best delay from which a joint counts as
following."""
LEAST_ROWS = 60
"""Fewest rows within the searched delays."""
SWAPPED_CORRELATION = 0.85
"""Correlation with another joint's action, on both sides, from which two joints are called
swapped."""
OWN_CORRELATION = 0.5
"""Correlation with the own action below which they are."""


@dataclass(frozen=True, eq=False)
class Following:
    """How joints follow their actions: names (K,), delay_s (K,) and std_s (K,) (s), correlation
    (K,)."""

    names: tuple[str, ...]
    delay_s: Array
    std_s: Array
    correlation: Array


def measure_action_delay(reading: EpisodeReading) -> Iterator[Measurement]:
    """Delay of the state behind the action (s), over the joints that follow it."""
    found = measure_following(reading)
    follows = found is not None and (found.correlation >= LEAST_CORRELATION) & np.isfinite(
        found.std_s
    )
    if found is None or not np.any(follows):
        return
    pooled = pool_values(found.delay_s[follows], found.std_s[follows])
    yield Measurement("action", pooled.mean, pooled.std)


def measure_action_error(reading: EpisodeReading) -> Iterator[Measurement]:
    """Root mean square of state minus the action that it follows, over joints, in the joints'
    unit."""
    found = measure_following(reading)
    if found is None or reading.joints is None or reading.action is None:
        return
    delay = next((one.value for one in measure_action_delay(reading)), 0.0)
    wanted = _actions_at_delays(reading.joints, reading.action, found.names, np.array([delay]))[0]
    columns = [reading.joints.names.index(name) for name in found.names]
    inside = _rows_with_known_actions(reading.joints.t, reading.action.t)
    error = (reading.joints.values[:, columns] - wanted)[inside]
    if error.size and np.isfinite(error).any():
        yield Measurement("action", float(np.sqrt(np.nanmean(error**2))))


def measure_swapped_joints(reading: EpisodeReading) -> Iterator[Measurement]:
    """1 for each pair of joints of which each follows the other's action and not its own."""
    joints = reading.joints
    action = reading.action
    if joints is None or action is None:
        return
    names = _common_moving(joints, action)
    if len(names) < 2 or len(joints.t) < LEAST_ROWS:
        return
    delay = next((one.value for one in measure_action_delay(reading)), 0.0)
    wanted = np.diff(_actions_at_delays(joints, action, names, np.array([delay]))[0], axis=0)
    states = np.diff(joints.values[:, [joints.names.index(name) for name in names]], axis=0)
    inside = _rows_with_known_actions(joints.t, action.t)[1:] & np.isfinite(states).all(axis=1)
    table = _correlate_steps(states[inside], wanted[inside])
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            across = min(table[a, b], table[b, a])
            if across > SWAPPED_CORRELATION and max(table[a, a], table[b, b]) < OWN_CORRELATION:
                text = f"{names[a]} and {names[b]} are swapped: each follows the other's action"
                yield Measurement(f"{names[a]}|{names[b]}", 1.0, None, text)


def _correlate_steps(states: Array, wanted: Array) -> Array:
    """Correlations (K,K) of steps of states (N,K) with steps of actions (N,K); 0 where either
    is still."""
    states = states - states.mean(axis=0)
    wanted = wanted - wanted.mean(axis=0)
    scale = np.outer(np.linalg.norm(states, axis=0), np.linalg.norm(wanted, axis=0))
    products = states.T @ wanted
    return np.asarray(np.divide(products, scale, out=np.zeros_like(scale), where=scale > 0.0))


def measure_following(reading: EpisodeReading) -> Following | None:
    """How each joint follows the action of its name; None without actions, or with too few rows."""
    joints = reading.joints
    action = reading.action
    if joints is None or action is None or joints.step_s <= 0.0:
        return None
    names = _common_moving(joints, action)
    inside = _rows_with_known_actions(joints.t, action.t)
    if not names or inside.sum() < LEAST_ROWS:
        return None
    step_s = joints.step_s / STEPS_PER_ROW
    tried = np.arange(round(EARLIEST_S / step_s), round(LATEST_S / step_s) + 1) * step_s
    states = np.diff(joints.values[:, [joints.names.index(name) for name in names]], axis=0)
    wanted = np.diff(_actions_at_delays(joints, action, names, tried), axis=1)
    rows = np.flatnonzero(inside[1:] & inside[:-1] & np.isfinite(states).all(axis=1))
    sums = [_block_sums(states[part], wanted[:, part]) for part in np.array_split(rows, BLOCKS)]
    whole = np.sum(sums, axis=0)
    best, correlation = _best_delay(whole, tried)
    left_out = np.array([_best_delay(whole - part, tried)[0] for part in sums])
    std_s = measure_jackknife_error(left_out)
    # the grid of delays limits what a parabola tells
    return Following(names, best, np.hypot(std_s, step_s / np.sqrt(12.0)), correlation)


def _common_moving(joints: StoredNumbers, action: StoredNumbers) -> tuple[str, ...]:
    """Names of joints that have an action and move, as it does."""
    moving = dict(zip(joints.names, value_ranges(joints.values) > 0.0, strict=True))
    asked = dict(zip(action.names, value_ranges(action.values) > 0.0, strict=True))
    return tuple(name for name in joints.names if moving[name] and asked.get(name, False))


def _rows_with_known_actions(t: Array, action_t: Array) -> Array:
    """Rows at t (N,) whose actions are known at every searched delay."""
    return np.asarray((t - LATEST_S >= action_t[0]) & (t - EARLIEST_S <= action_t[-1]))


def _actions_at_delays(
    joints: StoredNumbers, action: StoredNumbers, names: tuple[str, ...], delays: Array
) -> Array:
    """The actions (D,N,K) of joints `names`, as they were at the joints' times less each delay."""
    columns = [action.values[:, action.names.index(name)] for name in names]
    times = joints.t[None] - delays[:, None]
    return np.stack([np.interp(times, action.t, column) for column in columns], axis=2)


def _block_sums(states: Array, wanted: Array) -> Array:
    """Sums (3,D,K) of products, of squared states and of squared actions over rows."""
    products = np.einsum("nk,dnk->dk", states, wanted)
    squares = np.broadcast_to((states**2).sum(axis=0), products.shape)
    return np.stack([products, squares, (wanted**2).sum(axis=1)])


def _best_delay(sums: Array, tried: Array) -> tuple[Array, Array]:
    """The delays (K,) of highest correlation, and these correlations, from sums (3,D,K)."""
    scale = np.sqrt(sums[1] * sums[2])
    table = np.divide(sums[0], scale, out=np.zeros_like(scale), where=scale > 0.0)
    best = np.clip(table.argmax(axis=0), 1, len(tried) - 2)
    column = np.arange(table.shape[1])
    left, middle, right = (table[best + side, column] for side in (-1, 0, 1))
    shift = np.clip(fit_profile_peak(left, middle, right)[0], -1.0, 1.0)
    return tried[best] + shift * (tried[1] - tried[0]), middle
