"""Encoder readings between two knots, integrated exactly into information about the states at both knots.

Joints are independent. So one joint's readings form one element of Särkkä & García-Fernández (2021):
z' = A z + b + noise C, and information η, J about z.
"""

from dataclasses import dataclass, field

import numpy as np

from ...types import Array
from .motion_model import MotionModel
from .small import outer, product, spd_inverse, transposed_product


@dataclass(frozen=True, eq=False)
class Slots:
    """Readings of each interval, slot by slot: dt (L,B) s · encoders, var (L,M,B), NaN if silent."""

    dt: Array
    encoders: Array
    var: Array

    def part(self, some: slice) -> "Slots":
        """The slots of some intervals."""
        return Slots(self.dt[:, some], self.encoders[..., some], self.var[..., some])


@dataclass(frozen=True, eq=False)
class Bridge:
    """Per interval: move A (S,S,M,B), shift b (S,M,B), noise C (S,S,M,B); info J (S,S,M,B), pull η (S,M,B).

    prefix: A, b, C before and after each slot's reading, if requested.
    """

    move: Array
    shift: Array
    noise: Array
    info: Array
    pull: Array
    prefix: list[tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]] = field(default_factory=list)


def bridge(motion: MotionModel, slots: Slots, remember: bool = False) -> Bridge:
    """Elements of all intervals; `remember` keeps those of every slot for the smoother."""
    s, m, b = motion.states, motion.joints, slots.dt.shape[1]
    move, shift, noise = np.zeros((s, s, m, b)), np.zeros((s, m, b)), np.zeros((s, s, m, b))
    np.einsum("ssjb->sjb", move)[:] = 1.0
    info, pull = np.zeros((s, s, m, b)), np.zeros((s, m, b))
    prefix = []
    for dt, y, var in zip(slots.dt, slots.encoders, slots.var, strict=True):
        motion.carry(move, dt)
        motion.carry(shift, dt)
        motion.carry(noise, dt)
        motion.carry(noise.swapaxes(0, 1), dt)
        noise += motion.spread(dt)
        before = (move.copy(), shift.copy(), noise.copy()) if remember else None
        present = np.isfinite(y)
        if present.any():
            slope, reach = motion.observe(move), motion.observe(noise)
            total = motion.observe(reach) + var
            weight = present / total
            nu = np.where(present, y - motion.observe(shift), 0.0)
            info += outer(slope * weight, slope)
            pull += slope * (weight * nu)
            gain = reach * weight
            move -= outer(gain, slope)
            shift += gain * nu
            noise -= outer(gain, reach)
        if before is not None:
            prefix.append((before, (move.copy(), shift.copy(), noise.copy())))
    return Bridge(move, shift, noise, info, pull, prefix)


@dataclass(frozen=True, eq=False)
class Information:
    """Per interval: information about the knot before (S,S,M,B), the one after and across; right-hand sides (S,M,B)."""

    before: Array
    after: Array
    across: Array
    pull_before: Array
    pull_after: Array


def information(found: Bridge, low: Array, high: Array) -> Information:
    """Information about deviations from nominal states `low` and `high` (S,M,B) at both ends."""
    inverse = spd_inverse(found.noise)
    leant = transposed_product(found.move, inverse)
    miss = found.shift + (found.move * low[None]).sum(axis=1) - high
    pull = found.pull - (found.info * low[None]).sum(axis=1)
    after = (inverse * miss[None]).sum(axis=1)
    before = found.info + product(leant, found.move)
    return Information(before, inverse, -leant, pull - (leant * miss[None]).sum(axis=1), after)
