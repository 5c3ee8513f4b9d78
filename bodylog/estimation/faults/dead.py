"""Encoders that died, by their own readings alone: silent to the end, or fallen to exactly zero and staying there."""

import numpy as np

from ...types import Array
from .frozen import repeats
from .jumping import jumps

DEAD, LONGER = 1.0, 2.0
"""s: an encoder silent for longer at the end of a log is dead, unless it was silent for half as long before."""


def silent(t: Array, y: Array) -> float | None:
    """Time of the last word of an encoder that spoke and then fell silent for good; y (N,) rad at t (N,) s."""
    heard = np.flatnonzero(np.isfinite(y))
    if not len(heard):
        return None
    before = float(np.diff(t[heard]).max(initial=0.0))
    return float(t[heard[-1]]) if t[-1] - t[heard[-1]] > max(DEAD, LONGER * before) else None


def fallen(t: Array, y: Array) -> list[tuple[int, int]]:
    """Stretches [begin, end) of readings y (N,) rad at t (N,) s that repeat exactly zero, where no joint came there."""
    zeros = [(begin, end) for begin, end in repeats(t, y) if y[begin] == 0.0 and begin > 0]
    at = {k for k, _ in jumps(t, y)} if zeros else set[int]()
    return [run for run in zeros if run[0] in at]
