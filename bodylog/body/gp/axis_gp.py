"""A forward model with a chain of found axes as its mean."""

from dataclasses import dataclass
from functools import cached_property

from ...kinematics.axis_chain import AxisChain
from ...kinematics.axis_instant import compile_axes
from ...kinematics.instant import Instant
from ...types import Array
from .mean_gp import MeanAt, MeanGP


@dataclass(frozen=True, eq=False)
class AxisGP(MeanGP):
    """One marker before one camera or tracker, on joints whose axes were found without a URDF.

    chain: the axes of greatest posterior; its unknowns are those of `AxisChain.move_axes`.
    """

    chain: AxisChain

    def _evaluate_mean(self, x: Array) -> MeanAt:
        return self.chain.see(x)

    def _evaluate_mean_once(self, x: Array) -> MeanAt:
        return self._instant(x)

    @cached_property
    def _instant(self) -> Instant:
        return compile_axes(self.chain)
