"""An encoder whose offset steps: from one reading on, all its readings are off by a constant.

Time and size are those of greatest evidence of the whole filter. A size N(0, FAR²) with standard
error σ, and a time at any of N readings after the start, cost ½ ln(1 + FAR²/σ²) + ln N nats of it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...types import Array, Fault, FaultKind
from ..inference.initial_path import OFFSET_STD
from ..inference.problem import FilterProblem
from ..inference.solution import Solution
from ..inference.walk import filter_roughly
from ..noise.encoder_noise import MAX_MEMORY_S
from .threshold import PRIOR_STD_RAD


class OffsetHypothesis(NamedTuple):
    """A problem with one more offset, its cost (nats), and
    if it is a step the fault and what size and time cost.
    """

    problem: FilterProblem
    nats: float
    fault: Fault | None = None
    prior: float = 0.0


def total_free_energy(solution: Solution) -> float:
    """Free energy (nats) of a whole filtered log."""
    return float(solution.fold.unfold(solution.trace.nats).sum())


def find_likeliest_step(
    problem: FilterProblem, wandering: FilterProblem, joint: int, solved: Solution
) -> OffsetHypothesis | None:
    """The most likely step of one joint's encoder, given
    the problem without and with a `wandering` offset of it.

    None where the log determines no step.
    """
    encoders = problem.evidence.encoders
    assert encoders is not None
    y = encoders.values[:, joint]
    t = encoders.t

    def off(posed: FilterProblem) -> Array:
        solution = filter_roughly(posed, solved)
        return np.asarray(
            y - solution.fold.unfold(solution.trace.z[:, joint])[problem.timeline.encoders]
        )

    def without(row: int, size: float) -> FilterProblem:
        return _with_readings(problem, joint, np.where(np.arange(len(y)) >= row, y - size, y))

    def nats(row: int, size: float) -> float:
        return total_free_energy(filter_roughly(without(row, size), solved))

    late, size = _fit_two_levels(off(wandering))
    # a filter takes a step for motion at first: just before, images alone tell the angle
    unsure = (t > t[late] - MAX_MEMORY_S) & (t <= t[late])
    masked = np.where(unsure, np.nan, np.where(t > t[late], y - size, y))
    seen, _ = _fit_two_levels(off(_with_readings(problem, joint, masked)))
    steps = np.where(unsure, np.sign(size) * np.diff(y, prepend=np.nan), np.nan)
    rows = seen, int(np.nan_to_num(steps, nan=-np.inf).argmax())
    row = min(rows, key=lambda row: nats(row, size))
    # an encoder that is off so soon is off from the start
    row = row if t[row] - t[0] >= MAX_MEMORY_S else 0
    lowest = _fit_parabola_minimum(
        [nats(row, size + apart) for apart in (-OFFSET_STD, 0.0, OFFSET_STD)]
    )
    if lowest is None:
        return None
    cost, more, std = lowest
    size += more
    prior = float(
        0.5 * (np.log1p((PRIOR_STD_RAD / std) ** 2) + (size / PRIOR_STD_RAD) ** 2)
        + (np.log(len(t)) if row else 0.0)
    )
    kind = FaultKind.JUMPING if row else FaultKind.DRIFTING
    name = problem.evidence.joints[joint]
    fault = Fault("encoders", name, kind, float(t[row]), size, problem.evidence.unit, std)
    return OffsetHypothesis(without(row, size), cost + prior, fault, prior)


def _fit_parabola_minimum(nats: Sequence[float]) -> tuple[float, float, float] | None:
    """Lowest cost (nats) on a parabola through three
    OFFSET_STD apart, its place from the middle, its std (rad).
    """
    below, cost, above = nats
    bend = (below - 2.0 * cost + above) / OFFSET_STD**2
    slope = (above - below) / (2.0 * OFFSET_STD)
    return None if bend <= 0.0 else (cost - 0.5 * slope**2 / bend, -slope / bend, float(bend**-0.5))


def _with_readings(problem: FilterProblem, joint: int, y: Array) -> FilterProblem:
    """The problem with other readings y (N,) rad of one encoder."""
    encoders = problem.evidence.encoders
    assert encoders is not None
    values = np.where(np.arange(encoders.values.shape[1]) == joint, y[:, None], encoders.values)
    return replace(
        problem, evidence=replace(problem.evidence, encoders=replace(encoders, values=values))
    )


def _fit_two_levels(off: Array) -> tuple[int, float]:
    """The row from which on residuals (N,), NaN where missing, are best described by one level
    instead of 0, and that level.
    """
    count = np.maximum(np.isfinite(off)[::-1].cumsum()[::-1], 1)
    level = np.nan_to_num(off)[::-1].cumsum()[::-1] / count
    row = int((count * level**2).argmax())
    return row, float(level[row])
