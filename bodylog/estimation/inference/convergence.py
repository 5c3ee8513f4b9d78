"""Whether repeated sweeps over a log converge."""

import numpy as np

PATIENCE = 8
"""Sweeps without a smaller move after which the solution counts as not converging."""
STUCK = 1e-3
"""Standard deviations: smaller moves are left to die out."""


class DidNotConverge(Exception):
    """Sweeps over the log, or outliers' weights, did not converge."""


class Progress:
    """Watches how far sweeps still move; raises DidNotConverge after PATIENCE sweeps without progress."""

    def __init__(self) -> None:
        """No sweep yet."""
        self._least, self._stuck = np.inf, 0

    def note(self, move: float) -> None:
        """Record one sweep and its largest move, in standard deviations, which must be a number."""
        if np.isnan(move):
            raise DidNotConverge("rounding leaves no number")
        self._stuck = self._stuck + 1 if move > 0.9 * self._least and move > STUCK else 0
        self._least = min(self._least, move)
        if self._stuck > PATIENCE:
            raise DidNotConverge(f"{PATIENCE} sweeps have not come closer than {self._least:.2g}")
