"""A log cut into intervals between knots; one instant of each interval, a slot, is processed in parallel."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...types import Array

MOST = 8
"""Most instants of an interval: shorter intervals cost knots, longer ones numpy calls."""
LONG = 0.03
"""s: least length of an interval, so that fast encoders give no ill-conditioned knots."""
BEFORE = 0.05
"""s from knot 0, which has no measurement, to the first instant; a shorter interval is ill-conditioned."""
CLOSE = {2: 1e-4, 3: 5e-3}
"""s, by the motion's order: no knot is closer than this to the last one, to avoid rounding errors."""


@dataclass(frozen=True, eq=False)
class Knots:
    """Times t (E,) s of all instants · events (B−1,): indices of the knots; knot 0 is BEFORE the first instant."""

    t: Array
    events: Array

    @staticmethod
    def of(t: Array, order: int) -> "Knots":
        """Knots in equal numbers of instants t (E,) s, and at the last one."""
        at = np.arange(len(t))
        step = float(np.median(np.diff(t))) if len(t) > 1 else LONG
        most = max(MOST, int(np.ceil(LONG / max(step, 1e-6))))
        inner = ((at + 1) % most == 0) & (t[-1] - t > CLOSE[order])
        return Knots(t, np.flatnonzero(inner | (at == at[-1])))

    @property
    def count(self) -> int:
        """Number B of knots."""
        return len(self.events) + 1

    @cached_property
    def place(self) -> tuple[Array, Array]:
        """Slot and interval (E,) of every instant; an interval's last instant is the knot at its end."""
        at = np.arange(len(self.t))
        interval = np.searchsorted(self.events, at)
        begin = np.append(0, self.events[:-1] + 1)
        return at - begin[interval], interval

    def fold(self, a: Array, fill: float) -> Array:
        """(E,…) -> (slots,…,B−1), with `fill` where an interval has no further instant."""
        slot, interval = self.place
        folded = np.full((int(slot.max()) + 1, len(self.events), *a.shape[1:]), fill)
        folded[slot, interval] = a
        return np.ascontiguousarray(np.moveaxis(folded, 1, -1))

    def unfold(self, a: Array) -> Array:
        """(slots,…,B−1) -> (E,…)."""
        slot, interval = self.place
        return np.asarray(np.moveaxis(a, -1, 1)[slot, interval])

    def steps(self) -> Array:
        """Time (slots,B−1) s since each instant's predecessor, or since knot 0."""
        return self.fold(np.diff(self.t, prepend=self.t[0] - BEFORE), 0.0)
