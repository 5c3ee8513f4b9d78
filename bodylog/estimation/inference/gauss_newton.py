"""The generalised free-energy filter: belief over angles and rates, Gauss–Newton to convergence at every instant.

Under the Laplace approximation this is an iterated extended Kalman filter. Each sweep linearises all frames, and
filters all stretches of the log in parallel from the ends of their predecessors. Sweeps repeat until neither the
linearisation points nor the starts move: the fixed point is the sequential filter's solution.
"""

from dataclasses import replace

import numpy as np

from ...types import Array
from ..noise.correlated_noise import PAST
from .convergence import RESTING, SETTLED, SWEEPS, DidNotConverge, sure
from .filter_records import Readings
from .folds import Fold, fold_for
from .initial_path import handed_over, initial_tangents, starts
from .knot_problem import KnotProblem, full, knot_problem
from .problem import Problem
from .scan import rescan
from .solution import Solution
from .tangents import Tangents


def solve(problem: Problem, warm: Solution | None = None, at: str = "posterior", rest: float = SETTLED) -> Solution:
    """The sequential filter's fixed point; frames are linearised at the `posterior` (iterated) or the `prior` mean.

    The knots are solved first, then all instants, which changes only readings that the gate rejects. `warm` is a
    solution of the same log to start from; `rest`: tolerance on starts, in standard deviations.
    """
    knots, first = solve_knots(problem, warm, at, rest)
    fold = fold_for(len(problem.timeline.t))
    z, p = starts(problem, fold, first, np.searchsorted(knots.events, fold.lasts()))
    # a looser tolerance, so that residues of the knots' solution do not trigger full sweeps
    first.tangents.resting *= 2.0
    whole = swept(problem, fold, full(problem, fold), first.tangents, z, p, at, 2.0 * rest)
    return replace(whole, knots=(knots, first))


def solve_knots(problem: Problem, warm: Solution | None, at: str, rest: float) -> tuple[KnotProblem, Solution]:
    """The knot problem and its solution, which is the whole log's unless the gate rejects a pooled reading."""
    knots, tangents, z, p = initial_sweep(problem, warm)
    tangents.resting, tangents.share = RESTING * rest, PAST
    return knots, swept(knots.problem, knots.fold, knots.readings, tangents, z, p, at, rest)


def initial_sweep(problem: Problem, warm: Solution | None) -> tuple[KnotProblem, Tangents, Array, Array]:
    """Knot problem, tangents and starts to begin with: from the encoders alone, or from the solution `warm`."""
    if warm is None:
        knots = knot_problem(problem)
        return knots, *initial_tangents(knots.problem, knots.fold)
    short = warm.knots is not None and warm.knots[1].fold is warm.fold
    knots = warm.knots[0].of(problem) if warm.knots and short else knot_problem(problem, warm.gated())
    known, lasts = warm, knots.events[knots.fold.lasts()]
    if warm.knots is not None:
        known, lasts = warm.knots[1], np.searchsorted(warm.knots[0].events, lasts, "right") - 1
    return knots, warm.tangents.again(), *starts(knots.problem, knots.fold, known, lasts)


def swept(
    problem: Problem, fold: Fold, readings: Readings, tangents: Tangents, z: Array, p: Array, at: str, rest: float
) -> Solution:
    """Sweep from starts z (K,C), p (K,K,C) until convergence."""
    tangents.write(problem, fold, readings)
    trace, moving, move = None, np.ones(fold.count, bool), np.inf
    for _ in range(SWEEPS):
        moving |= tangents.draw(problem, fold, readings)
        if trace is not None and not moving.any():
            return Solution(fold, readings, tangents, trace)
        trace = rescan(readings, problem.dynamics, z, p, moving, trace)
        tangents.follow(problem, fold, trace.prior if at == "prior" else trace.z)
        next_z, next_p = handed_over(z, p, trace.z[-1], trace.p[-1])
        moves = far(z, p, next_z, next_p)
        # a converged start keeps the value it was scanned with, so that small moves add up
        moving, move = moves >= rest, sure(float(moves.max()))
        z[:, moving], p[:, :, moving] = next_z[:, moving], next_p[:, :, moving]
    raise DidNotConverge(f"laplace: no rest after {SWEEPS} sweeps, last move {move:.2g}")


def far(z: Array, p: Array, next_z: Array, next_p: Array) -> Array:
    """How far each start (C,) moved, in standard deviations."""
    std, before = (np.sqrt(np.maximum(np.einsum("iic->ic", cov), 1e-24)) for cov in (next_p, p))
    return np.asarray(np.maximum(np.abs((next_z - z) / std).max(axis=0), np.abs(before / std - 1.0).max(axis=0)))
