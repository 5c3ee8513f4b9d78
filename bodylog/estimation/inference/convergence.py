"""When repeated sweeps over a log have converged, and when they do not."""

import numpy as np

SWEEPS = 25
"""Most sweeps: both methods converge within 13 on 15 simulated and recorded logs."""
SETTLED = 1e-8
"""Standard deviations: a stretch's start that moves less has converged."""
ROUGHLY = 1e-2
"""Standard deviations: the same for comparing evidence, and for a path through silences."""
RESTING = 0.1
"""rad per standard deviation of that: a frame whose linearisation point moves less keeps its tangent."""


class DidNotConverge(Exception):
    """Sweeps over the log, or outliers' weights, did not converge."""


def sure(move: float) -> float:
    """A sweep's largest move; DidNotConverge if rounding left no number."""
    if np.isnan(move):
        raise DidNotConverge("rounding leaves no number")
    return move
