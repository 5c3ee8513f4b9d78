"""A long log folded into stretches that are filtered side by side: (E,…) in time order <-> (L,…,C)."""

from dataclasses import dataclass

import numpy as np

from ..types import Array

SHORTEST = 64


@dataclass(frozen=True)
class Fold:
    """C stretches of L instants hold E events; the last stretch is padded."""

    events: int
    length: int
    count: int

    def fold(self, a: Array, fill: float) -> Array:
        """(E,…) -> (L,…,C), padded with `fill`."""
        padded = np.full((self.length * self.count, *a.shape[1:]), fill)
        padded[: self.events] = a
        return np.ascontiguousarray(np.moveaxis(padded.reshape(self.count, self.length, *a.shape[1:]), 0, -1))

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


def fold_for(events: int) -> Fold:
    """About as many stretches as instants in each, so that neither numpy calls nor restarts dominate."""
    length = max(SHORTEST, int(np.ceil(np.sqrt(events))))
    return Fold(events, length, -(-events // length))
