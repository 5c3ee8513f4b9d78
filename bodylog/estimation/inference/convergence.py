"""When repeated sweeps over a log have converged, and when they do not."""

import numpy as np

from ...types import Array

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


def far(z: Array, p: Array, next_z: Array, next_p: Array) -> float:
    """How far the farthest start moved, in standard deviations."""
    std, before = (np.sqrt(np.maximum(np.einsum("iic->ic", cov), 1e-24)) for cov in (next_p, p))
    return float(np.maximum(np.abs((next_z - z) / std), np.abs(before / std - 1.0)).max())
