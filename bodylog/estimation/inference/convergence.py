"""When repeated sweeps over a log have converged, and when they do not."""

import numpy as np

from ...types import Array

MAX_SWEEPS = 25
"""Most sweeps: both methods converge within 13 on 15 simulated and recorded logs."""
CONVERGED_MOVE = 1e-9
"""Once converged, a stretch's start moves by fewer standard
deviations, a frame's linearisation point by fewer rad.
"""
ROUGHLY_CONVERGED_MOVE = 1e-3
"""The same for comparing evidence, for a path through silences and for a delay. With 1e-2 a
smoother keeps a wrong posture in a log whose encoder is off by 0.5 rad in its first two readings.
"""


class DidNotConverge(Exception):
    """Sweeps over the log, or outliers' weights, did not converge."""


def require_finite(move: float) -> float:
    """A sweep's largest move; DidNotConverge if rounding left no number."""
    if np.isnan(move):
        raise DidNotConverge("rounding leaves no number")
    return move


def measure_farthest_move(z: Array, p: Array, next_z: Array, next_p: Array) -> float:
    """How far the farthest start moved, in standard deviations."""
    std, before = (np.sqrt(np.maximum(np.einsum("iic->ic", cov), 1e-24)) for cov in (next_p, p))
    return float(np.maximum(np.abs((next_z - z) / std), np.abs(before / std - 1.0)).max())
