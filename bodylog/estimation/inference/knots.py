"""A log cut into intervals between knots; one instant of each interval, a slot, is processed in parallel."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...types import Array

MOST = 8
"""Most instants of an interval: shorter intervals cost knots, longer ones numpy calls."""
LONG = 0.03
"""s: least length of an interval without an image, so that fast encoders give no ill-conditioned knots."""
BEFORE = 0.05
"""s from knot 0, which has no measurement, to the first instant; a shorter interval is ill-conditioned."""
CLOSE = {2: 1e-4, 3: 5e-3}
"""s, by the motion's order: images closer than this share the later one's knot, to avoid rounding errors.

The neglected process noise moves an angle by √(q dt³/3) or √(q dt⁵/20), 1e-6 to 1e-5 rad.
"""


@dataclass(frozen=True, eq=False)
class Knots:
    """Times t (E,) s of all instants · events (B−1,): indices of the knots; knot 0 is BEFORE the first instant."""

    t: Array
    events: Array

    @staticmethod
    def of(t: Array, images: Array, order: int) -> "Knots":
        """Knots at instants `images` (ascending indices) unless close together, at the end, and in between."""
        wanted = np.zeros(len(t), bool)
        wanted[_apart(t, images, CLOSE[order])] = True
        wanted[-1] = True
        at = np.arange(len(t))
        since = at - np.maximum.accumulate(np.where(wanted, at, -1))
        step = float(np.median(np.diff(t))) if len(t) > 1 else LONG
        most = max(MOST, int(np.ceil(LONG / max(step, 1e-6))))
        after = np.append(t[wanted], np.inf)[np.searchsorted(np.flatnonzero(wanted), at)]
        return Knots(t, np.flatnonzero(wanted | ((since > 0) & (since % most == 0) & (after - t > CLOSE[order]))))

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

    def holding(self, images: Array) -> tuple[Array, Array]:
        """The knot (F,) at or after each of the instants `images`, and by how much (F,) s it is later."""
        event = np.searchsorted(self.events, images)
        return event + 1, self.t[images] - self.t[self.events[event]]


def _apart(t: Array, images: Array, close: float) -> Array:
    """The last instant of each group within `close` s."""
    if not len(images) or not (np.diff(t[images]) < close).any():
        return images
    kept = [int(images[-1])]
    for event in images[-2::-1]:
        if t[kept[-1]] - t[event] >= close:
            kept.append(int(event))
    return np.array(kept[::-1])
