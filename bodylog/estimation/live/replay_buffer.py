"""The last instants of a live filter: late readings
are inserted at their time and later ones re-applied.
"""

from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ...types import Array
from ..inference.sequential import State
from ..noise.correlated_noise import PendingFrame


@dataclass(eq=False)
class Instant:
    """Time t (s), the state after it, and its readings:
    angles (M,) rad, NaN where missing, or None, and frames.
    """

    t: float
    after: State
    angles: Array | None = None
    frames: Mapping[str, PendingFrame] = field(default_factory=dict)
    nats: float = 0.0

    def add(self, angles: Array | None, frames: Mapping[str, PendingFrame]) -> None:
        """Add readings of the same time."""
        if self.angles is not None and angles is not None:
            angles = np.where(np.isfinite(angles), angles, self.angles)
        self.angles = self.angles if angles is None else angles
        self.frames = {**self.frames, **frames}


class ReplayBuffer:
    """The instants of the last `lag` seconds, at least one, and the one before them."""

    def __init__(self, first: State, lag: float, step: Callable[[State, Instant], State]) -> None:
        """Only the `first` state; `step` gives the state after an instant from the one before."""
        self._instants = [Instant(first.t, first)]
        self._lag = lag
        self._step = step

    @property
    def last(self) -> State:
        """The state now."""
        return self._instants[-1].after

    def late(self, t: float) -> bool:
        """Whether t (s) is before all instants that can be recomputed."""
        return t <= self._instants[0].t

    def add(
        self, t: float, angles: Array | None, frames: Mapping[str, PendingFrame]
    ) -> tuple[State, State, float]:
        """Insert readings at t (s) and recompute all later
        instants: the states after t and now, and the nats added.
        """
        at = bisect_left(self._instants, t, key=lambda one: one.t)
        if at == len(self._instants) or self._instants[at].t > t:
            self._instants.insert(at, Instant(t, self._instants[at - 1].after))
        self._instants[at].add(angles, frames)
        nats = 0.0
        for before, instant in pairwise(self._instants[at - 1 :]):
            instant.after = self._step(before.after, instant)
            nats += instant.after.nats - instant.nats
            instant.nats = instant.after.nats
        then = self._instants[at].after
        while len(self._instants) > 2 and self._instants[1].t < self.last.t - self._lag:
            del self._instants[0]
        return then, self.last, nats
