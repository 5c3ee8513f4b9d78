"""A filtered log: the belief at every instant, and the linearisation."""

from dataclasses import dataclass

from ...types import Array
from . import adjoint
from .filter_records import FilterDynamics, FilterReadings
from .folds import Fold
from .scan import FilterTrace
from .tangents import Tangents


@dataclass(frozen=True, eq=False)
class Solution:
    """A filtered log: fold, its linearised readings, tangents, trace."""

    fold: Fold
    readings: FilterReadings
    tangents: Tangents
    trace: FilterTrace


@dataclass(frozen=True, eq=False)
class Smooth(Solution):
    """A smoothed log: the last forward pass, and the smoothed state z (L,K,C).

    cov (L,O,O,C): of the angles and, with offsets, of what the encoders read.
    """

    z: Array
    cov: Array


def assemble_smooth(
    fold: Fold,
    readings: FilterReadings,
    tangents: Tangents,
    trace: FilterTrace,
    ends: Array | None,
    dynamics: FilterDynamics,
) -> Smooth:
    """The smoothed log, with covariances, of a forward pass
    and the adjoints (K,C) at stretches' ends, or None.
    """
    x, cov = adjoint.smooth_with_covariances(readings, trace, ends, dynamics)
    return Smooth(fold, readings, tangents, trace.without_gains(), x, cov)
