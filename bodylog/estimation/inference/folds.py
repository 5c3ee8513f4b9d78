"""A long log folded into stretches that are filtered
in parallel: (E,…) in time order <-> (L,…,C).
"""

from dataclasses import dataclass

import numpy as np

from ...types import Array
from .kernel import LANES

MIN_STRETCH_INSTANTS = 32
"""Least number of instants in a stretch: its end must not depend on its start."""


@dataclass(frozen=True)
class Fold:
    """`count` stretches C of `length` instants L each."""

    events: int
    length: int
    count: int

    def fold(self, a: Array, fill: float | Array) -> Array:
        """(E,…) -> (L,…,C), with `fill` after the last event."""
        padded = np.empty((self.length * self.count, *a.shape[1:]))
        padded[: self.events], padded[self.events :] = a, fill
        return np.ascontiguousarray(
            np.moveaxis(padded.reshape(self.count, self.length, *a.shape[1:]), 0, -1)
        )

    def unfold(self, a: Array) -> Array:
        """(L,…,C) -> (E,…)."""
        return np.moveaxis(a, -1, 0).reshape(-1, *a.shape[1:-1])[: self.events]

    def pick(self, a: Array, events: Array) -> Array:
        """Rows (F,…) of the folded a (L,…,C) at the given events."""
        rows: Array = a[events % self.length, ..., events // self.length]
        return rows

    def put(self, a: Array, events: Array, rows: Array) -> None:
        """Write rows (F,…) into the folded a (L,…,C) at the given events."""
        a[events % self.length, ..., events // self.length] = rows

    def lasts(self) -> Array:
        """Last event (C−1,) before each stretch but the first starts."""
        return np.arange(1, self.count) * self.length - 1


def choose_fold(events: int) -> Fold:
    """Fold with as many stretches as the kernel filters side by side, if the log is long enough."""
    count = min(LANES, max(1, events // MIN_STRETCH_INSTANTS))
    length = max(1, -(-events // count))
    return Fold(events, length, max(1, -(-events // length)))
