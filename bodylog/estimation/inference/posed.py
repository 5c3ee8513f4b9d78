"""A log as one linear system about nominal states: motion and encoders between knots, and the prior of knot 0."""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from .banded import System, system
from .bridge import Bridge, Slots, bridge, information
from .knots import Knots
from .motion_model import MotionModel


@dataclass(frozen=True, eq=False)
class Chain:
    """A log: motion, knots, slots; mean (M,S) and cov (M,S,S) of the joints at knot 0."""

    motion: MotionModel
    knots: Knots
    slots: Slots
    mean: Array
    cov: Array

    def bridge(self, remember: bool = False) -> Bridge:
        """Integrated encoder readings between knots."""
        return bridge(self.motion, self.slots, remember)


def posed(chain: Chain, found: Bridge, nominal: Array) -> System:
    """The system about nominal states (K,B)."""
    m, s, knots = chain.motion.joints, chain.motion.states, nominal.shape[1]
    states = np.ascontiguousarray(nominal.reshape(m, s, knots).swapaxes(0, 1))
    into = system(information(found, states[..., :-1], states[..., 1:]), m)
    for j, (mean, inverse) in enumerate(zip(chain.mean, np.linalg.inv(chain.cov), strict=True)):
        own = slice(j * s, j * s + s)
        into.own[own, own, 0] += inverse
        into.pull[own, 0] -= inverse @ (nominal[own, 0] - mean)
    return into
