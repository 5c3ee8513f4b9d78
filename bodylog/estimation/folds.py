"""A long log folded into stretches that are filtered side by side: (E,…) in time order <-> (L,…,C)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..types import Array

FEW = 5000
"""Instants up to which stretches are short and overlap: a short log wants many of them, side by side."""
SHORT, OVERLAP = 96, 32
LONG = 128


@dataclass(frozen=True)
class Fold:
    """C stretches own `own` events each and look `over` further to both sides, so L = own + 2 over instants.

    The overlap lets an error in where a stretch starts die out before its own events begin.
    """

    events: int
    own: int
    over: int
    count: int

    @property
    def length(self) -> int:
        """Instants L of a stretch."""
        return self.own + 2 * self.over

    def fold(self, a: Array, fill: float) -> Array:
        """(E,…) -> (L,…,C), with `fill` before the first event and after the last."""
        padded = np.full((self.own * self.count + 2 * self.over, *a.shape[1:]), fill)
        padded[self.over : self.over + self.events] = a
        rows = np.arange(self.length)[:, None] + self.own * np.arange(self.count)
        return np.ascontiguousarray(np.moveaxis(padded[rows], 1, -1))

    def unfold(self, a: Array) -> Array:
        """(L,…,C) -> (E,…): each event from the stretch that owns it."""
        mine = a[self.over : self.over + self.own]
        return np.moveaxis(mine, -1, 0).reshape(-1, *a.shape[1:-1])[: self.events]

    def pick(self, a: Array, events: Array) -> Array:
        """Rows (F,…) of the folded a (L,…,C) at the given events."""
        rows: Array = a[events % self.own + self.over, ..., events // self.own]
        return rows

    def put(self, a: Array, events: Array, rows: Array) -> None:
        """Write rows (F,…) into the folded a (L,…,C) at the given events, in every stretch that sees them."""
        for which, instant, stretch in self._copies(events):
            a[instant, ..., stretch] = rows[which]

    def _copies(self, events: Array) -> Iterator[tuple[Array, Array, Array]]:
        stretch, instant = events // self.own, events % self.own + self.over
        for shift in (-1, 0, 1) if self.over else (0,):
            at, inside = stretch + shift, instant - shift * self.own
            which = (at >= 0) & (at < self.count) & (inside >= 0) & (inside < self.length)
            yield which, inside[which], at[which]

    def sees(self, events: Array) -> Array:
        """Which stretches (C,) have one of the events among their instants."""
        seen = np.zeros(self.count, bool)
        for _, _, stretch in self._copies(events):
            seen[stretch] = True
        return seen

    @property
    def handover(self) -> int:
        """Instant whose belief is where the next stretch starts."""
        return self.own - 1

    @property
    def takeover(self) -> int:
        """Instant before which the adjoint is where the previous stretch's way back starts."""
        return 2 * self.over

    def first_events(self) -> Array:
        """Last event (C−1,) before each stretch but the first starts."""
        return np.maximum(np.arange(1, self.count) * self.own - self.over - 1, 0)


def fold_for(events: int, over: int | None = None) -> Fold:
    """More stretches than instants in each, four times at the most, so that numpy calls do not dominate.

    A long stretch needs no overlap: what it hands over has long forgotten where it began.
    """
    long = events > FEW
    own = max(LONG, int(np.ceil(np.sqrt(events) / 2))) if long else max(SHORT, int(np.ceil(np.sqrt(events))))
    over = (0 if long else OVERLAP) if over is None else over
    count = -(-events // own)
    return Fold(events, own, over if count > 1 else 0, count)
