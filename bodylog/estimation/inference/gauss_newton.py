"""The generalised free-energy filter: belief over angles
and rates, Gauss–Newton to convergence at every instant.

Under the Laplace approximation this is an iterated extended Kalman filter. Each sweep linearises
all frames and filters the log. Sweeps repeat until no linearisation point moves: the fixed point is
the sequential filter's solution.
"""

from .convergence import CONVERGED_MOVE, MAX_SWEEPS, DidNotConverge, require_finite
from .folds import Fold, fold_readings
from .problem import FilterProblem
from .scan import filter_stretches
from .solution import Solution
from .tangents import Tangents, initial_tangents, stretch_priors


def solve_by_gauss_newton(
    problem: FilterProblem,
    warm: Solution | None = None,
    at: str = "posterior",
    rest: float = CONVERGED_MOVE,
) -> Solution:
    """The sequential filter's fixed point; frames are linearised
    at the `posterior` (iterated) or the `prior` mean.

    `warm` is a solution of the same log to start from; `rest`: tolerance on points, in rad.
    """
    fold = Fold.of(problem)
    tangents = begin_tangents(problem, warm)
    tangents.resting = rest
    tangents.whole = False
    readings = fold_readings(problem, fold)
    start = stretch_priors(problem, fold)
    trace = None
    tangents.write(problem, fold, readings)
    for _ in range(MAX_SWEEPS):
        moved = tangents.draw(problem, fold, readings)
        if trace is not None and not moved:
            return Solution(fold, readings, tangents, trace)
        trace = filter_stretches(readings, problem.dynamics, *start, into=trace)
        require_finite(trace.nats)
        tangents.follow(problem, fold, trace.prior if at == "prior" else trace.z)
    raise DidNotConverge(f"filter: no rest after {MAX_SWEEPS} sweeps")


def begin_tangents(problem: FilterProblem, warm: Solution | None) -> Tangents:
    """Tangents to begin with: from the encoders alone, or from the solution `warm`."""
    if warm is None:
        return initial_tangents(problem)
    return warm.tangents.again(problem.evidence.sightings)
