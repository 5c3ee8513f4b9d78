"""Skin readings to touches: cells above a threshold with
hysteresis, grouped where they neighbour in time and index.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...settings import SkinSettings
from ...types import Array, Finding, Health, Series, Touch

_NEIGHBOUR = 2
_PAUSE = 0.05
_GAP = 0.25
_LISTED = 8

Felt = tuple[tuple[Touch, ...] | None, Health, tuple[Finding, ...]]


@dataclass(frozen=True)
class _Press:
    """One cell above the threshold: onset, offset (s) by
    interpolation, and the samples first..last (last included).
    """

    cell: int
    onset: float
    offset: float
    first: int
    last: int


def detect_touches(skin: Series, settings: SkinSettings) -> Felt:
    """Touches in order of onset, health and findings; None
    where no cell can feel (all dead or stuck, no sample).
    """
    readable = np.isfinite(skin.values)
    # zero first: casting a signalling NaN gives a RuntimeWarning
    level = np.where(readable, skin.values, 0.0).astype(np.float32)
    health = _skin_health(skin.t, readable)
    if not level.size:
        return None, health, (Finding("warning", "skin: no readings; touch cannot be used"),)
    gap = _after_gaps(skin.t)
    active = _active_cells(level, settings, gap)
    dead = np.asarray((level == level[0]).all(axis=0) & (len(level) > 1))
    held = np.asarray(active.all(axis=0) & (len(active) > 1))
    findings = (*_unreadable_findings(readable), *_broken_cell_findings(level, dead, held))
    if (dead | held).all():
        return None, health, findings
    presses = _find_presses(skin.t, level, active & ~held, settings, gap)
    found = [
        _touch_of_presses(skin, level, group) for group in _group_presses(presses, settings.columns)
    ]
    return tuple(sorted(found, key=lambda touch: (touch.onset, touch.strongest))), health, findings


def _after_gaps(t: Array) -> Array:
    """(N,) bool: a sample that follows a gap in the readings."""
    steps = np.diff(t, prepend=t[0])
    return np.asarray(steps > max(_GAP, 5 * float(np.median(steps))))


def _active_cells(level: Array, settings: SkinSettings, gap: Array) -> Array:
    """(N,C) bool: at or above the threshold, or since then not below release or across a gap."""
    active = np.zeros(level.shape, dtype=bool)
    touched = np.flatnonzero((level >= settings.threshold).any(axis=0))
    felt = level[:, touched]
    order = np.arange(len(level), dtype=np.int32)[:, None]
    risen = np.maximum.accumulate(np.where(felt >= settings.threshold, order, -1), axis=0)
    fallen = np.maximum.accumulate(
        np.where((felt < settings.release) | gap[:, None], order, -1), axis=0
    )
    active[:, touched] = (risen >= fallen) & (risen >= 0)
    return active


def _find_presses(
    t: Array, level: Array, active: Array, settings: SkinSettings, gap: Array
) -> list[_Press]:
    """Every cell's active stretches of at least `shortest` s, in order of onset."""
    before = np.vstack([np.zeros_like(active[:1]), active[:-1]]) & ~gap[:, None]
    starts = np.argwhere((active & ~before).T)
    after = np.vstack([before[1:] & active[1:], np.zeros_like(active[:1])])
    ends = np.argwhere((active & ~after).T)
    found = []
    for (cell, first), (_, last) in zip(starts.tolist(), ends.tolist(), strict=True):
        last = first + int(np.flatnonzero(level[first : last + 1, cell] >= settings.threshold)[-1])
        onset = _threshold_crossing(
            t, level[:, cell], first - 1, first, settings.threshold, gap[first]
        )
        ended = last + 1 < len(t) and bool(gap[last + 1])
        offset = _threshold_crossing(t, level[:, cell], last + 1, last, settings.threshold, ended)
        if offset - onset >= settings.shortest:
            found.append(_Press(cell, onset, offset, first, last))
    return sorted(found, key=lambda press: (press.onset, press.cell))


def _threshold_crossing(
    t: Array, level: Array, outside: int, inside: int, threshold: float, alone: bool
) -> float:
    """When a line from the sample outside to the one inside
    crosses the threshold; at the inside one if it is alone.
    """
    if alone or not 0 <= outside < len(t):
        return float(t[inside])
    share = (threshold - level[outside]) / (level[inside] - level[outside])
    return float(t[outside] + share * (t[inside] - t[outside]))


def _group_presses(presses: Sequence[_Press], columns: int | None) -> list[list[_Press]]:
    """Join presses that are neighbours on the skin and overlap in time, or nearly."""
    groups: dict[int, list[_Press]] = {}
    recent: list[tuple[_Press, int]] = []
    for number, press in enumerate(presses):
        recent = [(other, group) for other, group in recent if press.onset <= other.offset + _PAUSE]
        joined = {
            group for other, group in recent if _are_neighbours(press.cell, other.cell, columns)
        }
        groups[number] = [
            press,
            *(other for group in sorted(joined) for other in groups.pop(group)),
        ]
        recent = [(other, number if group in joined else group) for other, group in recent] + [
            (press, number)
        ]
    return list(groups.values())


def _are_neighbours(cell: int, other: int, columns: int | None) -> bool:
    if columns is None:
        return abs(cell - other) <= _NEIGHBOUR
    row, column = divmod(cell, columns)
    other_row, other_column = divmod(other, columns)
    return max(abs(row - other_row), abs(column - other_column)) <= _NEIGHBOUR


def _touch_of_presses(skin: Series, level: Array, group: Sequence[_Press]) -> Touch:
    """One touch from its presses; the strongest cell
    is the one with the highest mean while pressed.
    """
    first = min(group, key=lambda press: (press.onset, press.cell))
    means: dict[int, float] = {}
    for press in group:
        mean = float(level[press.first : press.last + 1, press.cell].mean())
        means[press.cell] = max(mean, means.get(press.cell, 0.0))
    peak = max(float(level[press.first : press.last + 1, press.cell].max()) for press in group)
    return Touch(
        onset=first.onset,
        offset=max(press.offset for press in group),
        cells=tuple(sorted(means)),
        peak=peak,
        strongest=max(means, key=lambda cell: (means[cell], -cell)),
        source_ns=int(skin.source_ns[first.first]),
    )


def _skin_health(t: Array, readable: Array) -> Health:
    """Readings used: those with at least one finite cell."""
    used = readable.any(axis=1) if readable.size else np.zeros(len(t), dtype=bool)
    lost = int(len(t) - used.sum())
    gaps = np.diff(t[used])
    return Health(
        len(t),
        int(used.sum()),
        {"not a number": lost} if lost else {},
        float(gaps.max(initial=0.0)),
    )


def _unreadable_findings(readable: Array) -> tuple[Finding, ...]:
    if readable.all():
        return ()
    share = 1 - float(readable.mean())
    return (
        Finding(
            "warning", f"skin: {share:.1%} of the readings are not numbers, taken as untouched"
        ),
    )


def _broken_cell_findings(level: Array, dead: Array, held: Array) -> tuple[Finding, ...]:
    """Warnings about cells that cannot feel."""
    cells = level.shape[1]
    if dead.all() and (level == level[0, 0]).all():
        text = (
            f"skin: all {cells} cells read {level[0, 0]:g} from first to last; touch cannot be used"
        )
        return (Finding("warning", f"{text}; type: --without touch"),)
    if (dead | held).all():
        text = (
            f"skin: none of {cells} cells ever changes between touched and not; touch cannot be "
            "used"
        )
        return (Finding("warning", f"{text}; type: --without touch"),)
    found = []
    if (dead & ~held).any():
        found.append(
            Finding(
                "warning", f"skin: {_list_cells(dead & ~held)} never change their reading: dead"
            )
        )
    if held.any():
        found.append(
            Finding(
                "warning",
                f"skin: {_list_cells(held)} read touched from first to last: stuck, left out",
            )
        )
    return tuple(found)


def _list_cells(cells: Array) -> str:
    numbers = np.flatnonzero(cells).tolist()
    more = f" and {len(numbers) - _LISTED} more" if len(numbers) > _LISTED else ""
    return f"{len(numbers)} of {len(cells)} cells ({', '.join(map(str, numbers[:_LISTED]))}{more})"
