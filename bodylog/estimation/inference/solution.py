"""A filtered log: the belief at every instant, and the linearisation."""

from dataclasses import dataclass, field

import numpy as np

from ...types import Array
from .conditioning import GATE
from .filter_records import Readings
from .folds import Fold
from .knot_problem import KnotProblem
from .scan import Trace
from .tangents import Tangents


@dataclass(frozen=True, eq=False)
class Solution:
    """A filtered log: fold, its linearised readings, tangents, trace; and the knot problem with its solution."""

    fold: Fold
    readings: Readings
    tangents: Tangents
    trace: Trace
    knots: "tuple[KnotProblem, Solution] | None" = field(default=None, kw_only=True)

    def gated(self) -> Array:
        """Instants (E,) with an encoder reading beyond the gate."""
        return np.asarray((np.abs(self.fold.unfold(self.trace.encoder_d)) > GATE).any(axis=1))
