"""The generalised free-energy filter: belief over angles and rates, Gauss–Newton to convergence at every instant.

Under the Laplace approximation that is an iterated extended Kalman filter. All frames are linearised at once, all
stretches of the log are filtered side by side from the ends of their predecessors, and this is repeated until neither
the points of linearisation nor the starts move: the fixed point is the sequential filter's own.
"""

from dataclasses import replace

import numpy as np

from ...types import Array
from ..noise.correlated_noise import PAST
from .convergence import DidNotConverge, Progress
from .filter_records import Readings
from .folds import Fold, fold_for
from .initial_path import handed_over, outset, starts
from .knot_problem import KnotProblem, full, knot_problem
from .problem import Problem
from .scan import rescan
from .solution import Solution
from .tangents import RESTING, Tangents

SWEEPS = 40
SETTLED = 1e-8
"""Standard deviations: how little a stretch's start may still move."""


def solve(problem: Problem, warm: Solution | None = None, at: str = "posterior", rest: float = SETTLED) -> Solution:
    """The sequential filter's fixed point; frames are linearised at the `posterior` (iterated) or the `prior` mean.

    First in brief; then in full, which moves nothing but where the gate closes on readings that were pooled. `warm`
    is a solution of the same log to begin from; `rest` says how still starts (in std) must be to be done.
    """
    brief, first = solve_knots(problem, warm, at, rest)
    fold = fold_for(len(problem.timeline.t))
    z, p = starts(problem, fold, first, np.searchsorted(brief.events, fold.lasts()))
    # what rests in brief is not to move in full for the last of its moves
    first.tangents.resting *= 2.0
    whole = swept(problem, fold, full(problem, fold), first.tangents, z, p, at, 2.0 * rest)
    return replace(whole, brief=(brief, first))


def solve_knots(problem: Problem, warm: Solution | None, at: str, rest: float) -> tuple[KnotProblem, Solution]:
    """The log in brief and its solution: the whole log's, if the gate closes on no reading that is pooled."""
    brief, tangents, z, p = begun(problem, warm)
    tangents.resting, tangents.share = RESTING * rest / SETTLED, PAST
    return brief, swept(brief.problem, brief.fold, brief.readings, tangents, z, p, at, rest)


def begun(problem: Problem, warm: Solution | None) -> tuple[KnotProblem, Tangents, Array, Array]:
    """The log in brief, tangents and starts to begin with: by the encoders alone, or where `warm` ended."""
    if warm is None:
        brief = knot_problem(problem)
        return brief, *outset(brief.problem, brief.fold, brief.readings)
    short = warm.brief is not None and warm.brief[1].fold is warm.fold
    brief = warm.brief[0].of(problem) if warm.brief and short else knot_problem(problem, warm.gated())
    known, lasts = warm, brief.events[brief.fold.lasts()]
    if warm.brief is not None:
        known, lasts = warm.brief[1], np.searchsorted(warm.brief[0].events, lasts, "right") - 1
    return brief, warm.tangents.again(), *starts(brief.problem, brief.fold, known, lasts)


def swept(
    problem: Problem, fold: Fold, readings: Readings, tangents: Tangents, z: Array, p: Array, at: str, rest: float
) -> Solution:
    """Sweeps from starts z (K,C), p (K,K,C) until all rests."""
    tangents.write(problem, fold, readings)
    trace, moving, move, progress = None, np.ones(fold.count, bool), np.inf, Progress()
    for _ in range(SWEEPS):
        moving |= tangents.draw(problem, fold, readings)
        if trace is not None and not moving.any():
            return Solution(fold, readings, tangents, trace)
        trace = rescan(readings, problem.dynamics, z, p, moving, trace)
        tangents.follow(problem, fold, trace.prior if at == "prior" else trace.z)
        next_z, next_p = handed_over(z, p, trace.z[-1], trace.p[-1])
        moves = far(z, p, next_z, next_p)
        # a start that rests stays as it was scanned, so that small moves add up until they count
        moving, move = moves >= rest, float(moves.max())
        progress.note(move)
        z[:, moving], p[:, :, moving] = next_z[:, moving], next_p[:, :, moving]
    raise DidNotConverge(f"laplace: no rest after {SWEEPS} sweeps, last move {move:.2g}")


def far(z: Array, p: Array, next_z: Array, next_p: Array) -> Array:
    """How far each start (C,) moved, in standard deviations."""
    std, before = (np.sqrt(np.maximum(np.einsum("iic->ic", cov), 1e-24)) for cov in (next_p, p))
    return np.asarray(np.maximum(np.abs((next_z - z) / std).max(axis=0), np.abs(before / std - 1.0).max(axis=0)))
