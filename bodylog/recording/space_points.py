"""Points in space of topics and tables: in mm, whether they came in m or in mm."""

from dataclasses import replace

import numpy as np

from ..logs.tables.pose_columns import metres_per_unit, millimetres_note
from ..types import MM_PER_M, TRACK_AXES, Array, Finding, Series

SPACE_ENDS = tuple(
    tuple(f"{before}{axis}" for axis in (".x", ".y", ".z"))
    for before in ("", ".point", ".position", ".pose.position", ".transform.translation")
)
"""Possible ends of a path to a point in space: those of PointStamped, PoseStamped and others."""


def series_of_points(t: Array, points: Array, source_ns: Array, std: Array | None) -> Series:
    """Points (N,3) and std as they came, whose unit `points_in_mm` finds."""
    return Series(t, points, TRACK_AXES[3][0], "m", source_ns, std)


def points_in_mm(name: str, track: Series) -> tuple[Series, tuple[Finding, ...]]:
    """A track of `series_of_points` in mm, and a remark where it came in mm; others unchanged."""
    if track.unit != "m":
        return track, ()
    size = metres_per_unit(track.values)
    findings = () if size == 1.0 else (Finding("info", millimetres_note(name, track.values)),)
    scale = size * MM_PER_M
    std = None if track.std is None else np.asarray(track.std * scale)
    unit = TRACK_AXES[3][1]
    return replace(track, values=track.values * scale, std=std, unit=unit), findings
