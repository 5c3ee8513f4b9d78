"""The generalised free-energy filter: belief over angles and rates, Gauss–Newton to convergence at every instant.

Under the Laplace approximation this is an iterated extended Kalman filter. Each sweep linearises all frames, and
filters all stretches of the log side by side from the ends of their predecessors. Sweeps repeat until neither the
linearisation points nor the starts move: the fixed point is the sequential filter's solution.
"""

import numpy as np

from ...types import Array
from .convergence import SETTLED, SWEEPS, DidNotConverge, far, sure
from .folded_readings import folded_readings
from .folds import Fold, fold_for
from .initial_path import handed_over, initial_tangents, starts
from .problem import Problem
from .scan import scan
from .solution import Solution
from .tangents import Tangents


def solve(problem: Problem, warm: Solution | None = None, at: str = "posterior", rest: float = SETTLED) -> Solution:
    """The sequential filter's fixed point; frames are linearised at the `posterior` (iterated) or the `prior` mean.

    `warm` is a solution of the same log to start from; `rest`: tolerance on starts, in standard deviations.
    """
    fold = fold_for(len(problem.timeline.t))
    tangents, z, p = initial_sweep(problem, fold, warm)
    tangents.resting, tangents.whole = rest, False
    readings, trace, move = folded_readings(problem, fold), None, np.inf
    tangents.write(problem, fold, readings)
    for _ in range(SWEEPS):
        moved = tangents.draw(problem, fold, readings)
        if trace is not None and move < rest and not moved:
            return Solution(fold, readings, tangents, trace)
        trace = scan(readings, problem.dynamics, z, p, into=trace)
        tangents.follow(problem, fold, trace.prior if at == "prior" else trace.z)
        next_z, next_p = handed_over(z, p, trace.z[-1], trace.end_p)
        z, p, move = next_z, next_p, sure(far(z, p, next_z, next_p))
    raise DidNotConverge(f"laplace: no rest after {SWEEPS} sweeps, last move {move:.2g}")


def initial_sweep(problem: Problem, fold: Fold, warm: Solution | None) -> tuple[Tangents, Array, Array]:
    """Tangents and starts to begin with: from the encoders alone, or from the solution `warm`."""
    if warm is None:
        return initial_tangents(problem, fold)
    return warm.tangents.again(problem.evidence.sightings), *starts(problem, fold, warm)
