"""The last instants of a live filter: late readings are inserted at their time and later ones re-applied."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...types import Array
from ..inference.reacquisition import AcquisitionState
from .inputs import Observation


@dataclass(eq=False, slots=True)
class State:
    """After an instant t (s; −∞ before the first): the acquisition state, the instant's nats, and the belief.

    belief (K,K+1): the rows of the covariance, each followed by the mean ·
    borne (M) s: time at which each encoder last confirmed the belief; oldest (s): the least of these ·
    uneven: instants since p was made symmetric · errors {sense: standard deviations} of this instant ·
    lost (M,) bool: joints re-initialised at it · held (M,) bool: joints silent for long before it.
    """

    t: float
    belief: Array
    watch: AcquisitionState
    borne: list[float] = field(default_factory=list)
    oldest: float = -np.inf
    uneven: int = 0
    nats: float = 0.0
    errors: Mapping[str, Sequence[float] | Array] = field(default_factory=dict)
    lost: Array | None = None
    held: Array | None = None


@dataclass(eq=False)
class Instant:
    """Readings of time t (s): angles (M,) rad, NaN where missing, or None, and places; and the state after them."""

    t: float
    after: State | None = None
    angles: Array | None = None
    places: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    def add(self, given: Observation) -> None:
        """Add readings of the same time."""
        if self.angles is None or given.angles is None:
            self.angles = given.angles if self.angles is None else self.angles
        else:
            self.angles = np.where(np.isfinite(given.angles), given.angles, self.angles)
        self.places = {**self.places, **given.places}


class ReplayBuffer:
    """The instants of the last `lag` seconds, and the state before them."""

    def __init__(self, base: State, lag: float, hear: Callable[[State, Instant], State]) -> None:
        """An empty buffer; `hear` gives the state after an instant from the one before."""
        self._base, self._lag, self._hear = base, lag, hear
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

    def add(self, t: float, given: Observation) -> tuple[State, State, float]:
        """Insert readings at t (s) and recompute all later instants: the states after t and now, and the nats added."""
        index = self._index(t)
        self._instants[index].add(given)
        before = self._after(index)
        nats = 0.0
        for instant in self._instants[index:]:
            known = 0.0 if instant.after is None else instant.after.nats
            instant.after = before = self._hear(before, instant)
            nats += before.nats - known
        then = self._instants[index].after
        assert then is not None
        self._forget(before.t - self._lag)
        return then, before, nats

    def _index(self, t: float) -> int:
        """Index of the instant at t (s), inserted if missing."""
        index = len(self._instants)
        while index and self._instants[index - 1].t >= t:
            index -= 1
        if index == len(self._instants) or self._instants[index].t > t:
            self._instants.insert(index, Instant(t))
        return index

    def _forget(self, until: float) -> None:
        """Drop instants before `until` (s), except the last."""
        old = 0
        while old < len(self._instants) - 1 and self._instants[old].t < until:
            old += 1
        if old:
            self._base = self._after(old)
            del self._instants[:old]
