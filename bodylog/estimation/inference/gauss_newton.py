"""The generalised free-energy filter: belief over angles
and rates, Gauss–Newton to convergence at every instant.

Under the Laplace approximation this is an iterated extended Kalman filter. Each sweep linearises
all frames, and filters all stretches of the log side by side from the ends of their predecessors.
Sweeps repeat until neither the linearisation points nor the starts move: the fixed point is the
sequential filter's solution.
"""

import numpy as np

from ...types import Array
from .convergence import (
    CONVERGED_MOVE,
    MAX_SWEEPS,
    DidNotConverge,
    measure_farthest_move,
    require_finite,
)
from .folds import Fold, choose_fold, fold_readings
from .problem import FilterProblem
from .scan import filter_stretches
from .solution import Solution
from .tangents import Tangents, hand_over_starts, initial_tangents, stretch_priors


def solve_by_gauss_newton(
    problem: FilterProblem,
    warm: Solution | None = None,
    at: str = "posterior",
    rest: float = CONVERGED_MOVE,
) -> Solution:
    """The sequential filter's fixed point; frames are linearised
    at the `posterior` (iterated) or the `prior` mean.

    `warm` is a solution of the same log to start from;
    `rest`: tolerance on starts, in standard deviations.
    """
    fold = choose_fold(len(problem.timeline.t))
    tangents, z, p = initial_sweep(problem, fold, warm)
    tangents.resting = rest
    tangents.whole = False
    readings = fold_readings(problem, fold)
    trace = None
    move = np.inf
    tangents.write(problem, fold, readings)
    for _ in range(MAX_SWEEPS):
        moved = tangents.draw(problem, fold, readings)
        if trace is not None and move < rest and not moved:
            return Solution(fold, readings, tangents, trace)
        trace = filter_stretches(readings, problem.dynamics, z, p, into=trace)
        tangents.follow(problem, fold, trace.prior if at == "prior" else trace.z)
        next_z, next_p = hand_over_starts(z, p, trace.z[-1], trace.end_p)
        z, p, move = next_z, next_p, require_finite(measure_farthest_move(z, p, next_z, next_p))
    raise DidNotConverge(f"filter: no rest after {MAX_SWEEPS} sweeps, last move {move:.2g}")


def initial_sweep(
    problem: FilterProblem, fold: Fold, warm: Solution | None
) -> tuple[Tangents, Array, Array]:
    """Tangents and starts to begin with: from the encoders alone, or from the solution `warm`."""
    if warm is None:
        return initial_tangents(problem, fold)
    return warm.tangents.again(problem.evidence.sightings), *starts_from_solution(
        problem, fold, warm
    )


def starts_from_solution(
    problem: FilterProblem, fold: Fold, known: Solution
) -> tuple[Array, Array]:
    """Each stretch's start z (K,C), p (K,K,C) from a
    solution of the same log; new offsets from the prior.
    """
    (z, p), lasts = stretch_priors(problem, fold), fold.lasts()
    k = min(len(z), known.trace.z.shape[1])
    z[:k, 1:] = known.fold.pick(known.trace.z, lasts)[:, :k].T
    if known.fold == fold:
        p[:k, :k, 1:] = known.trace.end_p[:k, :k, :-1]
    return z, p
