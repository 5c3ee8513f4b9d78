"""Encoders that lie outright: frozen, dead or jumping ones, found in their own readings, named and set right."""

from dataclasses import replace

import numpy as np

from ..types import Array, Fault
from .senses import Encoders

FROZEN = 0.5
"""s: a noisy encoder that repeats one value exactly for longer is frozen."""
DEAD = 1.0
"""s: an encoder silent for longer at the end of a log is dead."""
JUMP = 12.0
"""Standard deviations of the readings' scatter by which the level must shift from one reading to the next."""
LEVEL = 5
"""Readings on each side of a jump that say how far it went."""
PAUSE = 3.0
"""Median steps in time: what an encoder reads after a longer silence may be where the joint has moved meanwhile."""


def screen(encoders: Encoders, names: tuple[str, ...]) -> tuple[Encoders, tuple[Fault, ...]]:
    """The encoders with frozen or dead stretches silenced and jumps taken back, and the faults (size 0 but for jumps).

    An encoder that repeats exactly zero is dead, and not even its first zero is sound.
    """
    values, found = encoders.values.copy(), []
    for joint, name in enumerate(names):
        column = values[:, joint]
        for begin, end in frozen(encoders.t, column):
            kind, begin = ("dead", begin - 1) if column[begin] == 0.0 else ("frozen", begin)
            found.append(Fault("encoders", name, kind, float(encoders.t[begin]), 0.0, "rad"))
            column[begin:end] = np.nan
        if (since := dead(encoders.t, column)) is not None and not any(f.name == name for f in found):
            found.append(Fault("encoders", name, "dead", since, 0.0, "rad"))
        for at, size in jumps(encoders.t, column):
            found.append(Fault("encoders", name, "jumping", float(encoders.t[at]), size, "rad"))
            column[at:] -= size
    return replace(encoders, values=values), tuple(sorted(found, key=lambda fault: fault.since))


def frozen(t: Array, y: Array) -> list[tuple[int, int]]:
    """Stretches [begin, end) in which a noisy encoder repeats itself exactly."""
    same = np.concatenate([[False], np.diff(y) == 0.0, [False]])
    edges = np.diff(same.astype(np.int8))
    runs = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) + 1, strict=True)
    long = [(int(begin), int(end)) for begin, end in runs if t[end - 1] - t[begin] > FROZEN]
    if not long or not noisy(np.delete(y, np.concatenate([np.arange(*run) for run in long]))):
        return []
    return [(begin + 1, end) for begin, end in long]  # the value it froze at was still sound


def noisy(y: Array) -> bool:
    """Whether readings scatter (their bends change sign at every turn), as those of an ideal sensor do not."""
    bends = np.diff(y[np.isfinite(y)], 2)
    if len(bends) < 10:
        return False
    return bool(np.mean(bends[1:] * bends[:-1] < 0) > 0.4)


def dead(t: Array, y: Array) -> float | None:
    """Time of the last word of an encoder that spoke and then fell silent for good."""
    heard = np.flatnonzero(np.isfinite(y))
    if not len(heard) or t[-1] - t[heard[-1]] <= DEAD:
        return None
    return float(t[heard[-1]])


def jumps(t: Array, y: Array) -> list[tuple[int, float]]:
    """Where the level shifts for good from one reading to the next (first index after), and by how much (rad)."""
    known = np.flatnonzero(np.isfinite(y))
    v, found = y[known], []
    if len(v) < 4 * LEVEL:
        return []
    steps, waits = np.diff(v), np.diff(t[known])
    bound = JUMP * _scatter(steps)
    for k in np.flatnonzero((np.abs(steps) > bound) & (waits < PAUSE * np.median(waits))):
        before, after = v[max(0, k + 1 - LEVEL) : k + 1], v[k + 1 : k + 1 + LEVEL]
        if len(before) < LEVEL or len(after) < LEVEL:
            continue
        size = _level(after[::-1]) - _level(before)
        apart = max(float(np.abs(np.diff(before)).max()), float(np.abs(np.diff(after)).max()))
        if abs(size) > bound and apart < abs(size) / 2:
            found.append((int(known[k + 1]), size))
    return found


def _scatter(steps: Array) -> float:
    """Robust standard deviation of steps (N,) rad; where most are none, as a coarse encoder's, the others' size."""
    if scatter := 1.4826 * float(np.median(np.abs(steps - np.median(steps)))):
        return scatter
    moved = np.abs(steps[steps != 0.0])
    return float(np.median(moved)) if len(moved) else 0.0


def _level(v: Array) -> float:
    """Level of a short piece at its last reading, by a straight line."""
    return float(np.polyfit(np.arange(1 - len(v), 1), v, 1)[1])
