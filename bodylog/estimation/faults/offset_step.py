"""An encoder whose offset steps: from one reading on, all its readings are off by a constant.

Time and size are those of greatest evidence of the whole filter. A size N(0, FAR²) with standard error σ, and a time at
any of N readings after the start, cost ½ ln(1 + FAR²/σ²) + ln N nats of it.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...types import Array, Fault
from ..inference.convergence import DidNotConverge
from ..inference.gauss_newton import solve
from ..inference.initial_path import OFFSET_STD
from ..inference.problem import Problem
from ..inference.solution import Solution
from ..noise.evidence_search import ROUGHLY
from .threshold import FAR

AROUND = 40
"""Readings on each side among which a step's time is refined."""


class Way(NamedTuple):
    """A problem with one more offset, its cost (nats), and the fault if the offset is a step."""

    problem: Problem
    nats: float
    fault: Fault | None = None


class _Trial(NamedTuple):
    """A reading (row) from which on an encoder is off by `size` rad, and the solution without that step."""

    row: int
    size: float
    problem: Problem
    solved: Solution

    @property
    def nats(self) -> float:
        """Cost of the whole log."""
        return free_energy(self.solved)


def free_energy(solution: Solution) -> float:
    """Free energy (nats) of a whole filtered log."""
    return float(solution.fold.unfold(solution.trace.nats).sum())


def likeliest_step(problem: Problem, wandering: Problem, joint: int, solved: Solution) -> Way | None:
    """The most likely step of one joint's encoder, given the problem without and with a `wandering` offset of it.

    None where the log determines no step, or without convergence.
    """
    # pooled readings of a known solution would still have the step
    fresh, encoders, first = replace(solved, knots=None), problem.evidence.encoders, wandering.dynamics.offset
    assert encoders is not None and first is not None

    def trial(row: int, size: float) -> _Trial:
        without = _without(problem, joint, row, size)
        return _Trial(row, size, without, solve(without, fresh, rest=ROUGHLY))

    try:
        row, size = _two_levels(_at_readings(wandering, solve(wandering, fresh, rest=ROUGHLY), first + joint))
        # an encoder that is off within the first second is off from the start
        late = encoders.t - encoders.t[0] >= 1.0
        chosen = _located(trial, encoders.values[:, joint], row, size, joint) if late[row] else None
        if chosen is None or not late[chosen.row]:
            chosen = trial(0, size)
        return _sized(trial, chosen, problem.evidence.joints[joint], encoders.t)
    except DidNotConverge:
        return None


def _without(problem: Problem, joint: int, row: int, size: float) -> Problem:
    """The problem with a step taken out of one encoder's readings."""
    encoders = problem.evidence.encoders
    assert encoders is not None
    values = encoders.values.copy()
    values[row:, joint] -= size
    return replace(problem, evidence=replace(problem.evidence, encoders=replace(encoders, values=values)))


def _at_readings(problem: Problem, solved: Solution, state: int) -> Array:
    """One filtered state (N,) at the encoders' readings."""
    return np.asarray(solved.fold.unfold(solved.trace.z[:, state])[problem.timeline.encoders])


def _two_levels(path: Array) -> tuple[int, float]:
    """The row from which on a path (N,) is best described by one level instead of 0, and that level."""
    count = np.arange(len(path), 0, -1)
    level = np.cumsum(path[::-1])[::-1] / count
    row = int((count * level**2).argmax())
    return row, float(level[row])


def _located(trial: Callable[[int, float], _Trial], y: Array, row: int, size: float, joint: int) -> _Trial:
    """The trial of least cost among rows about the first guess, for readings y (N,) rad."""
    tried = list[_Trial]()
    for guess in {row, _steepest(y, row, size)}:
        rows = set[int]()
        while guess not in rows and len(rows) < 6:
            rows.add(guess)
            tried.append(trial(guess, size))
            guess = _boundary(y - _at_readings(tried[-1].problem, tried[-1].solved, joint), guess, size)
    return min(tried, key=lambda one: one.nats)


def _steepest(y: Array, row: int, size: float) -> int:
    """The row about `row` at which readings y (N,) change most towards the size."""
    low, high = max(1, row - AROUND), min(len(y), row + AROUND)
    change = np.sign(size) * np.diff(y[low - 1 : high])
    return low + int(np.where(np.isfinite(change), change, -np.inf).argmax()) if high > low else row


def _boundary(off: Array, row: int, size: float) -> int:
    """The row about `row` that best divides residuals off (N,) into those about 0 and those about the size."""
    low = max(0, row - AROUND)
    near = off[low : row + AROUND]
    # squared distance from 0 less that from the size, summed over the rows before
    return low + int(np.append(0.0, np.cumsum(np.nan_to_num(size * (2.0 * near - size)))).argmin())


def _sized(trial: Callable[[int, float], _Trial], best: _Trial, name: str, t: Array) -> Way | None:
    """The size of greatest evidence by a parabola, twice, the second time as wide as the first one's error says."""
    half, std = 0.5 * OFFSET_STD, 0.0
    for _ in range(2):
        below, above = (trial(best.row, best.size + off).nats for off in (-half, half))
        bend = (below - 2.0 * best.nats + above) / half**2
        if bend <= 0.0:
            return None
        more = np.clip((below - above) / (2.0 * half * bend), -2.0 * half, 2.0 * half)
        best, std = trial(best.row, best.size + float(more)), float(bend**-0.5)
        half = 2.0 * std
    times = np.log(len(t)) if best.row else 0.0
    cost = best.nats + 0.5 * np.log1p((FAR / std) ** 2) + 0.5 * (best.size / FAR) ** 2 + times
    kind = "jumping" if best.row else "drifting"
    return Way(best.problem, float(cost), Fault("encoders", name, kind, float(t[best.row]), best.size, "rad", std))
