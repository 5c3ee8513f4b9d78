"""A filtered log: the belief at every instant, and the linearisation."""

from dataclasses import dataclass, field

import numpy as np

from ...types import Array
from .filter_records import GATE, Readings
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


@dataclass(frozen=True, eq=False)
class Path(Solution):
    """The last forward pass, with the smoothed state z (L,K,C) and the adjoints `after` (L,K,C) each instant."""

    z: Array
    after: Array


@dataclass(frozen=True, eq=False)
class Smooth(Path):
    """A smoothed log, with cov (L,O,O,C) of the angles and, with offsets, of what the encoders read."""

    cov: Array
