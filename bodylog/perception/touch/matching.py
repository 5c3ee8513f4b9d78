"""Match touches with strokes: one-to-one pairs, their delays, and the weight of each as one event."""

from collections.abc import Sequence

import numpy as np

from ...errors import ConfigError
from ...types import Array, Finding, Stroke, Synchrony, Touch

B2 = float(np.log(2.0) / 0.12**2)
"""b2 (1/s²) of f_t = exp(−b2 δ²), which halves at 0.12 s: vision captures touch up to a delay of about 0.1 s."""

_FARTHEST = 1.5
_STEADY = 0.05
_NOTABLE = 0.05
_ENOUGH = 3

Matches = tuple[tuple[Synchrony, ...], tuple[Finding, ...]]


def match_touches(touches: Sequence[Touch], strokes: Sequence[Stroke], clock_offset: float | str = 0.0) -> Matches:
    """One Synchrony per touch, in order, with f_t of the delay minus the clocks' offset (s).

    `clock_offset` "auto" subtracts the log's own median delay where its spread is small; ConfigError for other texts.
    """
    partners = _pairs(_costs(touches, strokes, 0.0 if clock_offset == "auto" else _seconds(clock_offset)))
    paired = [(i, j) for i, j in enumerate(partners) if j is not None]
    delays = np.array([_delay(touches[i], strokes[j]) for i, j in paired])
    offset, findings = _offset(delays, clock_offset)
    found = [Synchrony(touch, None, np.nan, 0.0) for touch in range(len(touches))]
    for (i, j), delay in zip(paired, (delays - offset).tolist(), strict=True):
        found[i] = Synchrony(i, j, delay, float(np.exp(-B2 * delay**2)))
    return tuple(found), findings


def _seconds(offset: float | str) -> float:
    try:
        return float(offset)
    except ValueError:
        raise ConfigError(
            f"synchrony.clock_offset: found '{offset}'; possible: auto, or seconds; type: clock_offset = 0.0"
        ) from None


def _delay(touch: Touch, stroke: Stroke) -> float:
    """Seen − felt (s), the mean of beginnings and ends."""
    return 0.5 * ((stroke.start - touch.onset) + (stroke.end - touch.offset))


def _costs(touches: Sequence[Touch], strokes: Sequence[Stroke], offset: float) -> Array:
    """The cost (T,S), s, of each touch with each stroke: the mean distance of beginnings and of ends."""
    felt = np.array([(touch.onset, touch.offset) for touch in touches]).reshape(-1, 1, 2)
    seen = np.array([(stroke.start, stroke.end) for stroke in strokes]).reshape(1, -1, 2)
    return np.asarray(np.abs(seen - felt - offset).mean(axis=2))


def _pairs(costs: Array) -> list[int | None]:
    """Each touch's stroke or None: pairs keep their order, each stroke serves once, the total cost is least.

    Leaving a touch and a stroke unpaired costs as much as a pair _FARTHEST s apart.
    """
    rows, columns = costs.shape
    total = np.zeros((rows + 1, columns + 1))
    alone = _FARTHEST / 2
    total[:, 0] = alone * np.arange(rows + 1)
    total[0, :] = alone * np.arange(columns + 1)
    for i in range(rows):
        for j in range(columns):
            total[i + 1, j + 1] = min(total[i, j] + costs[i, j], total[i, j + 1] + alone, total[i + 1, j] + alone)
    partners: list[int | None] = [None] * rows
    i, j = rows, columns
    while i and j:
        if total[i, j] == total[i - 1, j - 1] + costs[i - 1, j - 1]:
            i, j = i - 1, j - 1
            partners[i] = j
        elif total[i, j] == total[i - 1, j] + alone:
            i -= 1
        else:
            j -= 1
    return partners


def _offset(delays: Array, wanted: float | str) -> tuple[float, tuple[Finding, ...]]:
    """The offset to subtract from the delays (s), and findings: the median of at least three steady ones, or 0."""
    if not delays.size:
        return (0.0 if wanted == "auto" else _seconds(wanted)), ()
    middle, spread = float(np.median(delays)), _spread(delays)
    order = "after" if middle >= 0 else "before"
    text = f"synchrony: the camera shows touches {abs(middle):.3f} s {order} the skin feels them"
    text += f" (spread {spread:.3f} s, {delays.size} pairs)"
    steady = delays.size >= _ENOUGH and spread <= _STEADY
    if wanted != "auto":
        if steady and abs(middle) > _NOTABLE:
            text += "; if that is the camera's latency, type: --clock-offset auto"
        return _seconds(wanted), (Finding("info", text),)
    if steady:
        return middle, (Finding("info", f"{text}; subtracted as the clocks' offset"),)
    return 0.0, (Finding("warning", f"{text}; too few or too unsteady for a clocks' offset: none subtracted"),)


def _spread(delays: Array) -> float:
    """Robust standard deviation (s)."""
    return 1.4826 * float(np.median(np.abs(delays - np.median(delays))))
