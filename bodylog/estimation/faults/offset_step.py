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
from .repeats import SILENT
from .threshold import FAR


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
    encoders = problem.evidence.encoders
    assert encoders is not None
    y, t = encoders.values[:, joint], encoders.t

    def found(posed: Problem) -> Solution:
        return solve(posed, solved, rest=ROUGHLY)

    def trial(row: int, size: float) -> _Trial:
        without = _with_readings(problem, joint, np.where(np.arange(len(y)) >= row, y - size, y))
        return _Trial(row, size, without, found(without))

    def divided(posed: Problem) -> tuple[int, float]:
        solution = found(posed)
        return _two_levels(y - solution.fold.unfold(solution.trace.z[:, joint])[problem.timeline.encoders])

    try:
        late, size = divided(wandering)
        # a filter takes a step for motion at first: in the second before, images alone tell the angle
        unsure = (t > t[late] - SILENT) & (t <= t[late])
        masked = np.where(unsure, np.nan, np.where(t > t[late], y - size, y))
        seen, _ = divided(_with_readings(problem, joint, masked))
        steps = np.sign(size) * np.diff(y, prepend=np.nan)
        steepest = int(np.where(unsure & np.isfinite(steps), steps, -np.inf).argmax())
        best = min((trial(row, size) for row in sorted({late, seen, steepest})), key=lambda one: one.nats)
        # an encoder that is off within the first second is off from the start
        best = best if t[best.row] - t[0] >= SILENT else trial(0, size)
        return _sized(trial, best, problem.evidence.joints[joint], t)
    except DidNotConverge:
        return None


def _with_readings(problem: Problem, joint: int, y: Array) -> Problem:
    """The problem with other readings y (N,) rad of one encoder."""
    encoders = problem.evidence.encoders
    assert encoders is not None
    values = np.where(np.arange(encoders.values.shape[1]) == joint, y[:, None], encoders.values)
    return replace(problem, evidence=replace(problem.evidence, encoders=replace(encoders, values=values)))


def _two_levels(off: Array) -> tuple[int, float]:
    """The row from which on residuals (N,), NaN where missing, are best described by one level instead of 0, and that
    level.
    """
    count = np.maximum(np.isfinite(off)[::-1].cumsum()[::-1], 1)
    level = np.nan_to_num(off)[::-1].cumsum()[::-1] / count
    row = int((count * level**2).argmax())
    return row, float(level[row])


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
