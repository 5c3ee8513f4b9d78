"""Match touches with strokes: one-to-one pairs, their delays, the weight of each as one event."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...errors import ConfigError
from ...types import Array, Finding, Stroke, Synchrony, Touch

B2 = float(np.log(2.0) / 0.12**2)
"""b2 (1/s²) of f_t = exp(−b2 δ²), which halves at 0.12
s: vision captures touch up to a delay of about 0.1 s.
"""

_FARTHEST = 1.5
_ALONE = _FARTHEST / 2
_PAIRED, _TOUCH_ALONE, _STROKE_ALONE = range(3)
_STEADY = 0.05
_NOTABLE = 0.05
_ENOUGH = 3

Matches = tuple[tuple[Synchrony, ...], tuple[Finding, ...]]


def match_touches(
    touches: Sequence[Touch], strokes: Sequence[Stroke], clock_offset: float | str = 0.0
) -> Matches:
    """One Synchrony per touch, in order, with f_t of the delay minus the clocks' offset (s).

    `clock_offset` "auto" subtracts the log's own median delay where its spread is small;
    ConfigError for other texts.
    """
    partners = _assign_strokes(
        touches, strokes, 0.0 if clock_offset == "auto" else _parse_clock_offset(clock_offset)
    )
    paired = [(i, j) for i, j in enumerate(partners) if j is not None]
    delays = np.array([_delay_of_stroke(touches[i], strokes[j]) for i, j in paired])
    offset, findings = _offset_between_clocks(delays, clock_offset)
    found = [Synchrony(touch, None, np.nan, 0.0) for touch in range(len(touches))]
    for (i, j), delay in zip(paired, (delays - offset).tolist(), strict=True):
        found[i] = Synchrony(i, j, delay, float(np.exp(-B2 * delay**2)))
    return tuple(found), findings


def _parse_clock_offset(offset: float | str) -> float:
    try:
        return float(offset)
    except ValueError:
        raise ConfigError(
            f"synchrony.clock_offset: found '{offset}'; possible: auto, or seconds; type: "
            "clock_offset = 0.0"
        ) from None


def _delay_of_stroke(touch: Touch, stroke: Stroke) -> float:
    """Seen − felt (s), the mean of beginnings and ends."""
    return 0.5 * ((stroke.start - touch.onset) + (stroke.end - touch.offset))


def _assign_strokes(
    touches: Sequence[Touch], strokes: Sequence[Stroke], offset: float
) -> list[int | None]:
    """Each touch's stroke or None: in order, each stroke at most once, the total cost least.

    Leaving a touch and a stroke unpaired costs as much as a pair _FARTHEST s apart: only strokes
    that begin within twice that of a touch can be its partner, so each touch looks at no others.
    """
    felt = np.array([(touch.onset, touch.offset) for touch in touches]).reshape(-1, 2)
    seen = np.array([(stroke.start, stroke.end) for stroke in strokes]).reshape(-1, 2)
    low = np.searchsorted(seen[:, 0], felt[:, 0] + offset - 2 * _FARTHEST)
    high = np.searchsorted(seen[:, 0], felt[:, 0] + offset + 2 * _FARTHEST, side="right")
    rows = [_Row(0, [0.0], [_TOUCH_ALONE])]
    for touch, first, end in zip(felt, low.tolist(), high.tolist(), strict=True):
        costs = np.abs(seen[first:end] - touch - offset).mean(axis=1)
        rows.append(_next_row(rows[-1], first, costs.tolist()))
    return _trace_partners(rows, len(strokes))


class _Row(NamedTuple):
    """Least costs (s) of the touches up to one with the strokes before first, first + 1, …

    `step` is the last one to each of them. Beyond the last each further stroke stays unpaired.
    """

    first: int
    total: list[float]
    step: list[int]

    def at(self, stroke: int) -> float:
        """The least cost with the strokes before that one."""
        last = len(self.total) - 1
        beyond = max(0, stroke - self.first - last)
        return self.total[min(stroke - self.first, last)] + beyond * _ALONE


def _next_row(before: _Row, first: int, costs: list[float]) -> _Row:
    """The row of one more touch, whose costs with the strokes first, first + 1, … are given."""
    total = [before.at(first) + _ALONE]
    step = [_TOUCH_ALONE]
    for stroke, cost in enumerate(costs, first):
        ends = (before.at(stroke) + cost, before.at(stroke + 1) + _ALONE, total[-1] + _ALONE)
        total.append(min(ends))
        step.append(ends.index(total[-1]))
    return _Row(first, total, step)


def _trace_partners(rows: list[_Row], strokes: int) -> list[int | None]:
    """Each touch's stroke or None, read backwards from the last touch with all strokes."""
    partners: list[int | None] = [None] * (len(rows) - 1)
    touch = len(rows) - 1
    stroke = strokes
    while touch:
        row = rows[touch]
        stroke = min(stroke, row.first + len(row.total) - 1)
        step = row.step[stroke - row.first]
        if step == _PAIRED:
            partners[touch - 1] = stroke - 1
        touch -= step != _STROKE_ALONE
        stroke -= step != _TOUCH_ALONE
    return partners


def _offset_between_clocks(delays: Array, wanted: float | str) -> tuple[float, tuple[Finding, ...]]:
    """The offset to subtract from the delays (s), and
    findings: the median of at least three steady ones, or 0.
    """
    if not delays.size:
        return (0.0 if wanted == "auto" else _parse_clock_offset(wanted)), ()
    middle = float(np.median(delays))
    spread = 1.4826 * float(np.median(np.abs(delays - np.median(delays))))
    order = "after" if middle >= 0 else "before"
    text = f"synchrony: the camera shows touches {abs(middle):.3f} s {order} the skin feels them"
    text += f" (spread {spread:.3f} s, {delays.size} pairs)"
    steady = delays.size >= _ENOUGH and spread <= _STEADY
    if wanted != "auto":
        if steady and abs(middle) > _NOTABLE:
            text += "; if that is the camera's latency, type: --clock-offset auto"
        return _parse_clock_offset(wanted), (Finding("info", text),)
    if steady:
        return middle, (Finding("info", f"{text}; subtracted as the clocks' offset"),)
    return 0.0, (
        Finding(
            "warning", f"{text}; too few or too unsteady for a clocks' offset: none subtracted"
        ),
    )
