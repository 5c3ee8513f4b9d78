"""Frozen and dead encoders, found in their own readings: one value for long, exactly zero for good, or silence.

An encoder at rest repeats its reading, too, if it counts in steps or is read only after motion. So repeats count as a
fault only for encoders that are noisy all the time, at rest and in motion.
"""

import numpy as np

from ...types import Array
from ..measurements.long_arrays import all_of_row
from ..noise.quantisation import step_size
from .jumping import jumps

FROZEN, FEWEST = 0.5, 10
"""s and readings: shortest stretch of one repeated value that may be a freeze."""
SILENT = 1.0
"""s: shortest gap in an encoder's readings that counts as silence."""


def frozen(t: Array, y: Array) -> list[tuple[int, int]]:
    """Return stretches [begin, end) of readings y (N,) rad at t (N,) s where a noisy encoder repeats itself exactly."""
    long = repeats(t, y)
    if not long or not noisy(np.delete(y, np.concatenate([np.arange(*run) for run in long]))):
        return []
    return [(begin + 1, end) for begin, end in long]  # the first of the repeated values was sound


def dropped_to_zero(t: Array, y: Array) -> list[tuple[int, int]]:
    """Return stretches [begin, end) of readings y (N,) rad at t (N,) s that jump to exactly zero and stay there."""
    zeros = [(begin, end) for begin, end in repeats(t, y) if y[begin] == 0.0 and begin > 0]
    at = {k for k, _ in jumps(t, y)} if zeros else set[int]()
    return [run for run in zeros if run[0] in at]


def silent_since(t: Array, y: Array) -> float | None:
    """Time (s) of the last reading of an encoder that is silent from then on, or None; y (N,) rad at t (N,) s."""
    known = np.flatnonzero(np.isfinite(y))
    if not len(known):
        return None
    before = float(np.diff(t[known]).max(initial=0.0))
    # twice its longest silence before
    return float(t[known[-1]]) if t[-1] - t[known[-1]] > max(SILENT, 2.0 * before) else None


def repeats(t: Array, y: Array, fewest: int = FEWEST) -> list[tuple[int, int]]:
    """Return long stretches [begin, end) of bitwise equal readings y (N,) or (N,D) at t (N,) s, the first included."""
    same = np.diff(y, axis=0) == 0.0
    same = same if y.ndim == 1 else all_of_row(same)
    if np.count_nonzero(same) < fewest - 1:
        return []
    runs = zip(*(edges.tolist() for edges in _runs(same)), strict=True)
    return [(a, b + 1) for a, b in runs if t[b] - t[a] > FROZEN and b + 1 - a >= fewest]


def noisy(y: Array) -> bool:
    """Whether readings (N,) scatter all the time and rarely repeat."""
    y = y[np.isfinite(y)]
    bends = np.diff(y, 2)
    # second differences of noise change sign 73 % of the time; an encoder that repeats more often counts in steps
    if len(bends) < 10 or np.mean(np.diff(y) == 0.0) > 0.02 or np.mean(bends[1:] * bends[:-1] < 0) <= 0.4:
        return False
    width = min(16, len(bends))
    scatter = np.sqrt(np.square(bends[: len(bends) // width * width].reshape(-1, width)).mean(axis=1))
    usual = float(np.median(scatter))
    # a quiet window is rest; rounding alone scatters bends by √(6/12) = 0.7 of a step, noise of one step by √6.5 = 2.5
    return bool(scatter.min() > 0.2 * usual) and usual > 1.35 * step_size(y)


def repeat_nats(y: Array) -> tuple[float, float]:
    """Nats that the longest run of equal readings (N,) wins over chance repeats, and its value.

    At most 0 for an encoder that counts in steps: rest explains its repeats.
    """
    y = y[np.isfinite(y)]
    same = np.diff(y, prepend=np.nan) == 0.0
    begins, ends = _runs(same)
    run = slice(0, 0) if not len(begins) else slice(*(int(a[(ends - begins).argmax()]) for a in (begins, ends)))
    nats = _run_nats(same, run.stop - run.start)
    resting = nats > 0.0 and not noisy(np.delete(y, run))
    return min(nats, 0.0) if resting else nats, float(y[run.start])


def silence_nats(y: Array) -> float:
    """Nats that silence from the last reading (N,) on wins over readings that are missing by chance."""
    missing = ~np.isfinite(y)
    return _run_nats(missing, int(missing[::-1].argmin()))


def _runs(true: Array) -> tuple[Array, Array]:
    """First indices and ends of the runs of True."""
    edges = np.flatnonzero(np.diff(true, prepend=False, append=False))
    return edges[::2], edges[1::2]


def _run_nats(true: Array, count: int) -> float:
    """Nats against a run of `count` by chance, with the share of True elsewhere; it may begin at any of N readings."""
    share = (np.count_nonzero(true) - count + 0.5) / (len(true) - count + 1.0)
    return float(-count * np.log(share) - np.log(len(true)))
