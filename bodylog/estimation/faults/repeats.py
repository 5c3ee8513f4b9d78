"""Repeated readings and silence: of frozen and dead encoders, and of sound ones at rest.

An encoder at rest repeats its reading, too, if it counts in steps or is read only after motion. So
repeats alone are a fault only of encoders that are noisy all the time, at rest and in motion.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ...types import Array, FaultKind
from ..inference.reacquisition import LONG_SILENCE_S
from ..measurements.long_arrays import all_of_row
from ..noise.encoder_noise import MAX_MEMORY_S
from ..noise.quantisation import step_size
from .jumping import find_level_shifts
from .threshold import EVIDENCE_THRESHOLD_NATS

MAX_REPEAT_SHARE = 0.02
"""Largest share of repeats of a noisy encoder; one that repeats more often counts in steps."""


class RepeatedReadings(NamedTuple):
    """Readings [begin, end) that a frozen or dead encoder
    repeats, none if it is silent, and the nats it wins.
    """

    kind: FaultKind
    begin: int
    end: int
    nats: float


def find_frozen_readings(
    t: Array, y: Array, moved: Callable[[int, int], float]
) -> Iterator[RepeatedReadings]:
    """Yield long repeats in readings y (N,) rad at t (N,) s: of a noisy
    encoder, after a fall to exactly zero, or while its joint moved, as
    images show; `moved` gives their nats for readings [begin, end).
    """
    long = find_equal_stretches(t, y)
    if not long:
        return
    scatters = has_steady_scatter(np.delete(y, np.concatenate([np.arange(*run) for run in long])))
    fell = {at: nats for at, _, nats in find_level_shifts(t, y) if y[at] == 0.0}
    for begin, end in long:
        chance = (end - begin - 1) * -np.log(MAX_REPEAT_SHARE) - np.log(len(y)) if scatters else 0.0
        nats = max(float(chance), fell.get(begin, 0.0), moved(begin, end))
        dead = y[begin] == 0.0
        # the first of the values that a frozen encoder repeats was sound
        kind = FaultKind.DEAD if dead else FaultKind.FROZEN
        yield RepeatedReadings(kind, begin + (not dead), end, nats)


def find_final_silence(t: Array, y: Array) -> RepeatedReadings:
    """The last of readings y (N,) rad at t (N,) s: dead
    since then if MAX_MEMORY_S and twice its longest gap ago.
    """
    known = np.flatnonzero(np.isfinite(y))
    longest = np.diff(t[known]).max(initial=0.0)
    last = int(known[-1])
    return RepeatedReadings(
        FaultKind.DEAD,
        last,
        last,
        EVIDENCE_THRESHOLD_NATS * float(t[-1] - t[last]) / max(MAX_MEMORY_S, 2.0 * longest),
    )


def find_equal_stretches(t: Array, y: Array) -> list[tuple[int, int]]:
    """Return long stretches [begin, end) of bitwise equal
    readings y (N,) or (N,D) at t (N,) s, the first included.
    """
    same = np.diff(y, axis=0) == 0.0
    same = same if y.ndim == 1 else all_of_row(same)
    edges = np.flatnonzero(np.diff(same, prepend=False, append=False)).tolist()
    runs = zip(edges[::2], edges[1::2], strict=True)
    return [(a, b + 1) for a, b in runs if t[b] - t[a] > LONG_SILENCE_S]


def split_stretch(t: Array) -> list[Array]:
    """Rows of each part of a stretch of instants t (N,)
    s, a part being half the shortest stretch of repeats.
    """
    count = int(2.0 * np.ptp(t) / LONG_SILENCE_S) if len(t) else 0
    return np.array_split(np.arange(len(t)), min(count, len(t))) if count else []


def has_steady_scatter(y: Array) -> bool:
    """Whether readings (N,) scatter all the time and rarely repeat."""
    y = y[np.isfinite(y)]
    bends = np.diff(y, 2)
    # second differences of noise change sign 73 % of the time
    if (
        len(bends) < 10
        or np.mean(np.diff(y) == 0.0) > MAX_REPEAT_SHARE
        or np.mean(bends[1:] * bends[:-1] < 0) <= 0.4
    ):
        return False
    width = min(16, len(bends))
    scatter = np.sqrt(
        np.square(bends[: len(bends) // width * width].reshape(-1, width)).mean(axis=1)
    )
    usual = float(np.median(scatter))
    # a quiet window is rest; rounding alone scatters bends by
    # √(6/12) = 0.7 of a step, noise of one step by √6.5 = 2.5
    return bool(scatter.min() > 0.2 * usual) and usual > 1.35 * step_size(y)
