"""When repeated sweeps over a log have converged, and when they do not."""

import numpy as np

from ...types import Array

MAX_SWEEPS = 25
"""Most sweeps: both methods converge within 13 on 15 simulated and recorded logs."""
CONVERGED_MOVE = 1e-9
"""Once converged, a frame's linearisation point moves by fewer rad."""
ROUGHLY_CONVERGED_MOVE = 1e-3
"""The same for comparing evidence, for a path through silences and for a delay. With 1e-2 a
smoother keeps a wrong posture in a log whose encoder is off by 0.5 rad in its first two readings.
"""


class DidNotConverge(Exception):
    """Sweeps over the log, or outliers' weights, did not converge."""


def require_finite(nats: Array) -> None:
    """DidNotConverge if rounding left no number in a sweep's free energy."""
    if np.isnan(nats).any():
        raise DidNotConverge("rounding leaves no number")
