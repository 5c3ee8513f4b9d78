"""Sources that track something through a camera's
frames in order: their table, and the tracks they give.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...sources import CharucoSource, Source, TagSource
from ...types import Array, Finding, Health, Series
from ..tags import charuco, tags
from .contract import HIDDEN, Tracked, Tracker

__all__ = ["FRAME_SOURCES", "Tracked", "Tracker", "make_trackers", "series_of_tracked"]

FRAME_SOURCES: Mapping[type[Source], Callable[[Mapping[str, Any]], list[Tracker]]] = {
    TagSource: tags.tag_trackers,
    CharucoSource: charuco.charuco_trackers,
}
"""The kinds of source that need frames in the order
of the file: features {name: source} -> trackers.
"""


def make_trackers(features: Mapping[str, Source]) -> list[Tracker]:
    """The trackers of one camera, for all features searched for in its frames."""
    found: list[Tracker] = []
    for kind, begin in FRAME_SOURCES.items():
        if some := {name: source for name, source in features.items() if isinstance(source, kind)}:
            found += begin(some)
    return found


def series_of_tracked(
    tracked: Sequence[Tracked], t: Array, source_ns: Array, numbers: Array
) -> tuple[dict[str, Series], dict[str, Health], tuple[Finding, ...]]:
    """Series (u, v, std px; NaN where not seen), Health
    by reason, and findings; `numbers` (n,): which frames.
    """
    tracks: dict[str, Series] = {}
    health: dict[str, Health] = {}
    findings: list[Finding] = []
    for one in tracked:
        rows = one.values[numbers]
        why = one.reasons[numbers]
        for k, name in enumerate(one.names):
            tracks[name] = Series(t, rows[:, k, :2], ("u", "v"), "px", source_ns, rows[:, k, 2:])
            health[name] = _health_of_tracked(t, np.isfinite(rows[:, k, 0]), why)
        findings += one.findings
    return tracks, health, tuple(findings)


def _health_of_tracked(t: Array, used: Array, why: Array) -> Health:
    """Counts of one track; a part not seen in a frame that shows the rest counts as hidden."""
    kinds, counts = np.unique(np.where(why[~used] == "", HIDDEN, why[~used]), return_counts=True)
    gaps = np.diff(t[used])
    rejected = dict(zip(kinds.tolist(), counts.tolist(), strict=True))
    return Health(int(t.size), int(used.sum()), rejected, float(gaps.max()) if gaps.size else 0.0)
