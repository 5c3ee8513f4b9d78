"""Dead encoders, found in their own readings: silent until the end, or dropped to exactly zero for good."""

import numpy as np

from ...types import Array
from .frozen import repeats
from .jumping import jumps

DEAD, LONGER = 1.0, 2.0
"""s: shortest silence at the end of a log of a dead encoder, and the multiple of its longest earlier silence."""


def silent_since(t: Array, y: Array) -> float | None:
    """Time (s) of the last reading of an encoder that is silent from then on, or None; y (N,) rad at t (N,) s."""
    known = np.flatnonzero(np.isfinite(y))
    if not len(known):
        return None
    before = float(np.diff(t[known]).max(initial=0.0))
    return float(t[known[-1]]) if t[-1] - t[known[-1]] > max(DEAD, LONGER * before) else None


def dropped_to_zero(t: Array, y: Array) -> list[tuple[int, int]]:
    """Return stretches [begin, end) of readings y (N,) rad at t (N,) s that jump to exactly zero and stay there."""
    zeros = [(begin, end) for begin, end in repeats(t, y) if y[begin] == 0.0 and begin > 0]
    at = {k for k, _ in jumps(t, y)} if zeros else set[int]()
    return [run for run in zeros if run[0] in at]
