"""The last instants of a live filter: late readings are inserted at their time and later ones re-applied."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ...types import Array
from ..inference.sequential import State
from ..noise.correlated_noise import PendingFrame


@dataclass(eq=False)
class Instant:
    """Readings of time t (s): angles (M,) rad, NaN where missing, or None, and frames; and the state after them."""

    t: float
    after: State | None = None
    angles: Array | None = None
    frames: Mapping[str, PendingFrame] = field(default_factory=dict)

    def add(self, angles: Array | None, frames: Mapping[str, PendingFrame]) -> None:
        """Add readings of the same time."""
        if self.angles is not None and angles is not None:
            angles = np.where(np.isfinite(angles), angles, self.angles)
        self.angles = self.angles if angles is None else angles
        self.frames = {**self.frames, **frames}


class ReplayBuffer:
    """The instants of the last `lag` seconds, at least one, and the state before them."""

    def __init__(self, base: State, lag: float, step: Callable[[State, Instant], State]) -> None:
        """An empty buffer; `step` gives the state after an instant from the one before."""
        self._base, self._lag, self._step = base, lag, step
        self._instants: list[Instant] = []

    @property
    def last(self) -> State:
        """The state now."""
        return self._after(len(self._instants))

    def _after(self, count: int) -> State:
        """The state after the first `count` instants."""
        after = self._instants[count - 1].after if count else self._base
        assert after is not None
        return after

    def late(self, t: float) -> bool:
        """Whether t (s) is before all instants that can be recomputed."""
        return t <= self._base.t

    def add(
        self, t: float, angles: Array | None, frames: Mapping[str, PendingFrame]
    ) -> tuple[State, State, float]:  # fmt: skip
        """Insert readings at t (s) and recompute all later instants: the states after t and now, and the nats added."""
        index = len(self._instants)
        while index and self._instants[index - 1].t >= t:
            index -= 1
        if index == len(self._instants) or self._instants[index].t > t:
            self._instants.insert(index, Instant(t))
        self._instants[index].add(angles, frames)
        before = self._after(index)
        nats = 0.0
        for instant in self._instants[index:]:
            known = 0.0 if instant.after is None else instant.after.nats
            instant.after = before = self._step(before, instant)
            nats += before.nats - known
        then = self._instants[index].after
        assert then is not None
        while len(self._instants) > 1 and self._instants[0].t < before.t - self._lag:
            self._base = self._after(1)
            del self._instants[0]
        return then, before, nats
