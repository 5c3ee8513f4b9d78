"""An encoder whose offset steps: from one reading on, all its readings are off by a constant.

Time and size are those of greatest evidence of the whole filter. A size N(0, FAR²) with standard error σ, and a time at
any of N readings after the start, cost ½ ln(1 + FAR²/σ²) + ln N nats of it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...types import Array, Fault
from ..inference.initial_path import OFFSET_STD
from ..inference.problem import Problem
from ..inference.solution import Solution
from ..inference.walk import filtered
from ..noise.encoder_noise import MEMORY
from .threshold import FAR


class Way(NamedTuple):
    """A problem with one more offset, its cost (nats), and if it is a step the fault and what size and time cost."""

    problem: Problem
    nats: float
    fault: Fault | None = None
    prior: float = 0.0


def free_energy(solution: Solution) -> float:
    """Free energy (nats) of a whole filtered log."""
    return float(solution.fold.unfold(solution.trace.nats).sum())


def likeliest_step(problem: Problem, wandering: Problem, joint: int, solved: Solution) -> Way | None:
    """The most likely step of one joint's encoder, given the problem without and with a `wandering` offset of it.

    None where the log determines no step.
    """
    encoders = problem.evidence.encoders
    assert encoders is not None
    y, t = encoders.values[:, joint], encoders.t

    def off(posed: Problem) -> Array:
        solution = filtered(posed, solved)
        return np.asarray(y - solution.fold.unfold(solution.trace.z[:, joint])[problem.timeline.encoders])

    def without(row: int, size: float) -> Problem:
        return _with_readings(problem, joint, np.where(np.arange(len(y)) >= row, y - size, y))

    def nats(row: int, size: float) -> float:
        return free_energy(filtered(without(row, size), solved))

    late, size = _two_levels(off(wandering))
    # a filter takes a step for motion at first: just before, images alone tell the angle
    unsure = (t > t[late] - MEMORY) & (t <= t[late])
    masked = np.where(unsure, np.nan, np.where(t > t[late], y - size, y))
    seen, _ = _two_levels(off(_with_readings(problem, joint, masked)))
    steps = np.where(unsure, np.sign(size) * np.diff(y, prepend=np.nan), np.nan)
    rows = seen, int(np.nan_to_num(steps, nan=-np.inf).argmax())
    row = min(rows, key=lambda row: nats(row, size))
    # an encoder that is off so soon is off from the start
    row = row if t[row] - t[0] >= MEMORY else 0
    lowest = _lowest([nats(row, size + apart) for apart in (-OFFSET_STD, 0.0, OFFSET_STD)])
    if lowest is None:
        return None
    cost, more, std = lowest
    size += more
    prior = float(0.5 * (np.log1p((FAR / std) ** 2) + (size / FAR) ** 2) + (np.log(len(t)) if row else 0.0))
    kind, name = "jumping" if row else "drifting", problem.evidence.joints[joint]
    fault = Fault("encoders", name, kind, float(t[row]), size, problem.evidence.unit, std)
    return Way(without(row, size), cost + prior, fault, prior)


def _lowest(nats: Sequence[float]) -> tuple[float, float, float] | None:
    """Lowest cost (nats) on a parabola through three OFFSET_STD apart, its place from the middle, its std (rad)."""
    below, cost, above = nats
    bend, slope = (below - 2.0 * cost + above) / OFFSET_STD**2, (above - below) / (2.0 * OFFSET_STD)
    return None if bend <= 0.0 else (cost - 0.5 * slope**2 / bend, -slope / bend, float(bend**-0.5))


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
