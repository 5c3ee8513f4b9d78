"""Nats for and against the hypotheses that an encoder froze, died or jumped, from its own readings."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ...types import Array, Fault, Hypothesis
from ..measurements.records import Encoders
from .frozen import noisy
from .jumping import jump_nats
from .threshold import NATS

KINDS = {"frozen": "encoder frozen", "dead": "encoder dead", "jumping": "encoder jumped"}
"""Kinds of fault and the names of their hypotheses."""


def weighed(
    encoders: Encoders, names: tuple[str, ...], faults: Sequence[Fault], stalls: Mapping[int, float]
) -> Iterator[Hypothesis]:
    """Yield each joint's hypotheses; stalls {joint: nats} by which images show motion during repeats."""
    for joint, name in enumerate(names):
        found, column = {fault.kind for fault in faults if fault.name == name}, encoders.values[:, joint]
        if not np.isfinite(column).any():
            continue
        repeated, value = _repeat_nats(column)
        nats = {
            "frozen": max(stalls.get(joint, -np.inf), repeated if value != 0.0 else min(repeated, 0.0)),
            "dead": max(_silence_nats(column), repeated if value == 0.0 else -np.inf),
            "jumping": jump_nats(encoders.t, column),
        }
        for kind, hypothesis in KINDS.items():
            yield Hypothesis(hypothesis, name, float(nats[kind]), NATS, kind in found)


def _repeat_nats(y: Array) -> tuple[float, float]:
    """Nats that the longest run of equal readings (N,) wins over chance repeats, and its value.

    At most 0 for an encoder that counts in steps: rest explains its repeats.
    """
    y = y[np.isfinite(y)]
    same = np.diff(y, prepend=np.nan) == 0.0
    begin, count = _longest(same)
    nats = _run_nats(same, count)
    resting = nats > 0.0 and not noisy(np.delete(y, np.arange(begin, begin + count)))
    return min(nats, 0.0) if resting else nats, float(y[begin])


def _silence_nats(y: Array) -> float:
    """Nats that silence from the last reading (N,) on wins over readings that are missing by chance."""
    missing = ~np.isfinite(y)
    return _run_nats(missing, int(missing[::-1].argmin()))


def _longest(true: Array) -> tuple[int, int]:
    """First index and length of the longest run of True."""
    edges = np.flatnonzero(np.diff(true, prepend=False, append=False))
    lengths = edges[1::2] - edges[::2]
    return (0, 0) if not len(lengths) else (int(edges[::2][lengths.argmax()]), int(lengths.max()))


def _run_nats(true: Array, count: int) -> float:
    """Nats against a run of `count` by chance, with the share of True elsewhere; it may begin at any of N readings."""
    share = (np.count_nonzero(true) - count + 0.5) / (len(true) - count + 1.0)
    return float(-count * np.log(share) - np.log(len(true)))
