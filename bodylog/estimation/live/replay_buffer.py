"""The last instants of a live filter, so that what comes late is heard where it belongs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...types import Array
from ..inference.reacquisition import AcquisitionState
from ..inference.scalar_steps import Rows
from .inputs import Told


@dataclass(eq=False, slots=True)
class State:
    """After an instant t (s; −∞ before the first): z (K), p (K,K) as lists, what was heard last · the instant's nats.

    borne (M) s: when each encoder bore the belief out last; oldest (s): the least of these, −∞ while joints are
    adrift · uneven: instants since rounding's asymmetry was taken out of p · errors
    {sense: standard deviations} of what was heard then · lost (M,) bool: joints the belief began anew with then.
    """

    t: float
    z: list[float]
    p: Rows
    watch: AcquisitionState
    borne: list[float] = field(default_factory=list)
    oldest: float = -np.inf
    uneven: int = 0
    nats: float = 0.0
    errors: Mapping[str, Sequence[float] | Array] = field(default_factory=dict)
    lost: Array | None = None


@dataclass(eq=False)
class Instant:
    """What is heard at t (s): angles (M,) rad, NaN where silent, or None, and places; and the state after."""

    t: float
    after: State | None = None
    angles: Array | None = None
    places: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    def add(self, told: Told) -> None:
        """Hear this, too."""
        if self.angles is None or told.angles is None:
            self.angles = told.angles if self.angles is None else self.angles
        else:
            self.angles = np.where(np.isfinite(told.angles), told.angles, self.angles)
        self.places = {**self.places, **told.places}


class Recent:
    """The instants of the last `lag` seconds, and the state before them."""

    def __init__(self, base: State, lag: float, hear: Callable[[State, Instant], State]) -> None:
        """None yet; `hear` makes the state after an instant from the one before."""
        self._base, self._lag, self._hear = base, lag, hear
        self._instants: list[Instant] = []

    @property
    def last(self) -> State:
        """The state now."""
        return self._after(len(self._instants))

    def _after(self, count: int) -> State:
        """The state after so many of the instants."""
        after = self._instants[count - 1].after if count else self._base
        assert after is not None
        return after

    def late(self, t: float) -> bool:
        """Whether t (s) is before all that can be heard again."""
        return t <= self._base.t

    def add(self, t: float, told: Told) -> tuple[State, State, float]:
        """Hear what is told at t (s), and all since then again: the states after t and now, and the nats it cost."""
        index = self._index(t)
        self._instants[index].add(told)
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
        """Which instant is at t (s), a new one if there was none."""
        index = len(self._instants)
        while index and self._instants[index - 1].t >= t:
            index -= 1
        if index == len(self._instants) or self._instants[index].t > t:
            self._instants.insert(index, Instant(t))
        return index

    def _forget(self, until: float) -> None:
        """Instants before `until` (s), though never the last."""
        old = 0
        while old < len(self._instants) - 1 and self._instants[old].t < until:
            old += 1
        if old:
            self._base = self._after(old)
            del self._instants[:old]
