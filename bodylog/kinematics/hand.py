"""What an arm holds, as a weight at it pulls the arm's joints."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from ..types import Array
from .pose import LEAST_LEVER

COMPLIANCE_SPREAD = 1.0
"""Standard deviation of a joint's compliance, in shares of what all joints have alike: those of
one arm differ by factors of up to five, and of the simulated one by none.
"""


class Hand(Protocol):
    """What an arm holds, at which a weight pulls.

    is_upright: whether it is known which way; then there is one direction, for all hands of a
    robot, else there are three, of this hand's own · still_joints: names of R joints that may carry
    what it holds, and stood still in the exploration.
    """

    @property
    def is_upright(self) -> bool:
        """Whether the levers are upwards."""

    @property
    def still_joints(self) -> tuple[str, ...]:
        """Names of R joints."""

    def measure_levers(self, q: Array) -> Array:
        """How far each joint moves the hand along each direction, m (or shares of a distance) per
        rad, at q (N,M) rad: (N,M,1), or (N,M,6), with those of links behind.
        """

    def show_still_joints(self, q: Array) -> tuple[Array, Array]:
        """What joints that stood still change in images (N,D,R), per rad, and how far they move the
        hand along each direction (N,R,1) or (N,R,3).
        """


@runtime_checkable
class _HoldingModel(Protocol):
    """A model of a track that knows what the arm may hold."""

    @property
    def hands(self) -> tuple[Hand, ...]:
        """What the arm may hold."""


def list_hands(model: object) -> tuple[Hand, ...]:
    """What the arm may hold before a track; nothing where the model does not know."""
    return model.hands if isinstance(model, _HoldingModel) else ()


def find_hands(models: Sequence[object], q: Array) -> tuple[Hand, ...]:
    """What the arm may hold, of the track before which most joints turn at q (N,M) rad."""
    best: tuple[Hand, ...] = ()
    most = 0
    for model in models:
        hands = list_hands(model)
        counts = [len(list_carrying_joints(one, q)) for one in hands]
        if max(counts, default=0) > most:
            best = tuple(one for one, count in zip(hands, counts, strict=True) if count)
            most = max(counts)
    return best


def list_carrying_joints(hand: Hand, q: Array) -> list[int]:
    """Joints that carry the hand, at angles q (N,M) rad."""
    own = np.abs(hand.measure_levers(q)).max(axis=(0, 2))
    return np.flatnonzero(own > LEAST_LEVER).tolist()


def find_same_hand(model: object, hand: Hand) -> Hand | None:
    """The hand as a track's model shows it; None if it does not."""
    for own in list_hands(model):
        if own is hand or (own.is_upright and hand.is_upright):
            return own
    return None
