"""The role of each column of a pose table, by its name: joint,
image position, point in space, image file, time, or unused.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import LogError
from ..records import Array
from ..topics import TRACKER
from .frame_columns import PLACE, frame_poses
from .table_file import FileTable, read_table_file, table_format

IMAGES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")
_UNITS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_TIME = re.compile(
    r"(?:unix|epoch|ros)?_?(?:t|time|stamp|timestamp|secs?|seconds|unix|epoch)(?:_(ns|us|ms|s|sec))?",
    re.IGNORECASE,
)
_LABEL = re.compile(
    r"pose|row|index|idx|id|no|nr|num|number|n|#|count|frame|sample|episode|unnamed.*|\w+_(id|index|idx)",
    re.IGNORECASE,
)
_PLACE = re.compile(r"(?P<name>.+)[_.](?P<axis>[uv])")
_STD = re.compile(
    r"(?P<name>.+)[_.](?:(?:std|sigma)[_.](?P<axis>[uvxyz])|(?P<before>[uvxyz])[_.](?:std|sigma)"
    r"|(?:std|sigma))"
)
_SPAN_M = 20.0
"""No arm moves a point as far, m; in mm, an arm moves it farther."""
LENS = ("fx", "fy", "cx", "cy")
"""Columns with the camera's focal lengths and centre, px."""
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
SIZE = ("width", "height")
_SPACE = re.compile(r"(?P<name>.+)[_.](?P<axis>[xyz]|q[xyzw])", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class PoseColumns:
    """joints (names) · tracks {name: positions (N,2) px, or points (N,3)
    m} · std {name: the same} · images {column: files} · t (N,) s.

    `time`: the column of times, None if rows are numbered · notes on the roles of the columns ·
    odd: what columns lack beside them.
    lens {LENS and others: number}: of the camera; empty without its columns.
    """

    joints: Mapping[str, Array]
    tracks: Mapping[str, Array]
    std: Mapping[str, Array]
    images: Mapping[str, Array]
    t: Array
    time: str | None
    notes: tuple[str, ...]
    lens: Mapping[str, float]
    odd: tuple[str, ...] = ()


def assign_column_roles(table: FileTable, path: str) -> PoseColumns:
    """Assign a role to each column; LogError if there is neither a joint nor a position."""
    left = dict(table.numbers)
    notes = list[str]()
    images = {name: files for name, files in table.texts.items() if are_image_files(files)}
    time, t = _take_time_column(left, table.rows, notes)
    frames = frame_poses(left, path)
    points, odd = _take_point_columns(left, {one.name for one in frames})
    tracks, std, partial = _take_track_columns(left, points)
    odd |= _find_lone_columns(left)
    scales = {name: metres_per_unit(places) for name, places in points.items()}
    for name, scale in scales.items():
        tracks[name] = tracks[name] * scale
        std |= {name: std[name] * scale} if name in std else {}
    notes += [millimetres_note(name, points[name]) for name in points if scales[name] != 1.0]
    lens = _take_lens_columns(left, path)
    labels = [name for name in left if is_label_column(name)]
    spaces = list(
        dict.fromkeys(
            [*_find_space_columns(left), *(column for one in frames for column in one.columns)]
        )
    )
    empty = [name for name, values in left.items() if not np.isfinite(values).any()]
    unused = dict.fromkeys(
        [*(n for n in table.texts if n not in images), *labels, *spaces, *empty, *odd]
    )
    joints = {name: values for name, values in left.items() if name not in unused}
    if frames and not joints:
        joints = frames[0].coordinates
        for column in frames[0].columns:
            unused.pop(column, None)
        what = (
            "a pose in each row; its coordinates (m, rad) stand for joints, whose zeros stay "
            "unknown"
        )
        notes.append(f"{frames[0].name}: {what}")
    if not joints and not tracks and not images:
        have = ", ".join(table.names[:12])
        raise LogError(
            f"{path}: no column is a joint, NAME_u and NAME_v, NAME_x, NAME_y and NAME_z, or "
            f"image files; the columns are {have}"
        )
    notes += _describe_used_columns(joints, tracks, images, time)
    notes += [f"the camera's lens: {', '.join(lens)}"] if lens else []
    if unused:
        notes.append(f"columns not used: {', '.join(unused)}")
    return PoseColumns(
        joints,
        tracks,
        std,
        images,
        t,
        time,
        tuple(notes),
        lens,
        (*dict.fromkeys(odd.values()), *partial),
    )


def are_image_files(files: Array) -> bool:
    """Whether most texts of a column end like an image file's name."""
    filled = [str(name) for name in files.tolist() if name]
    return bool(filled) and sum(name.lower().endswith(IMAGES) for name in filled) > len(filled) / 2


def _take_time_column(
    left: dict[str, Array], rows: int, notes: list[str]
) -> tuple[str | None, Array]:
    """The column of times, removed from `left`, and the
    rows' times (N,) s: row numbers if no column is sound.
    """
    name, t = time_column(left)
    if name is None:
        notes.append("no column of times; t is the row's number, counted from 0")
        return None, np.arange(rows, dtype=float)
    left.pop(name)
    for other in [other for other in left if _TIME.fullmatch(other)]:
        left.pop(other)
        notes.append(f"column {other} is a second column of times; {name} is used")
    if not np.isfinite(t).all() or (np.diff(np.sort(t)) <= 0).any() or np.abs(t).max() > 9e9:
        notes.append(
            f"column {name} does not date every row differently; t is the row's number, "
            "counted from 0"
        )
        return None, np.arange(rows, dtype=float)
    if np.diff(np.sort(t)).max(initial=0) > 86_400 / 2:
        notes.append(
            f"column {name} leaps by more than half a day; t is the row's number, counted from 0"
        )
        return None, np.arange(rows, dtype=float)
    return name, t


def time_column(numbers: Mapping[str, Array]) -> tuple[str | None, Array]:
    """The first column named as a time, and its times (N,) s; None without one."""
    name = next((name for name in numbers if _TIME.fullmatch(name)), None)
    return (None, np.empty(0)) if name is None else (name, numbers[name] * _time_column_scale(name))


def read_timed_table(path: Path) -> tuple[FileTable, Array | None]:
    """The table in a file, and its times (N,) s; None where no column is named as a time."""
    with path.open("rb") as stream:
        form = table_format(path, stream.read(4)) or "csv"
    table = read_table_file(path, form)
    column, t = time_column(table.numbers)
    return table, None if column is None else t


def is_label_column(name: str) -> bool:
    """Whether a column counts or labels its rows, by its name."""
    return _LABEL.fullmatch(name) is not None


def _time_column_scale(name: str) -> float:
    """Seconds per unit of a time column, by the end of its name."""
    match = _TIME.fullmatch(name)
    unit = (match[1] or "s").lower() if match else "s"
    return _UNITS.get(unit, 1.0)


def _take_point_columns(
    left: dict[str, Array], frames: Collection[str]
) -> tuple[dict[str, Array], dict[str, str]]:
    """Points (N,3) of NAME_x, NAME_y and NAME_z, removed from `left`, by track; and, of names with
    two of the three, the missing column by those there; names of poses have other columns.
    """
    points = dict[str, Array]()
    halves = dict[str, str]()
    for name, found in _axes_by_name(left).items():
        known = {axis: found[axis] for axis in PLACE if axis in found}
        if name in frames or len(known) < len(found) or len(known) < 2 or _STD.fullmatch(name):
            continue
        if len(known) == 2:
            missing = next(axis for axis in PLACE if axis not in known)
            first, second = known.values()
            halves[first] = f"{first} and {second} without {name}_{missing} are no point in space"
            halves[second] = halves[first]
            continue
        track = name if "/" in name else f"{TRACKER}/{name}"
        points[track] = np.column_stack([left.pop(known[axis]) for axis in PLACE])
    return points, halves


def _find_lone_columns(left: Mapping[str, Array]) -> dict[str, str]:
    """What is missing beside columns of a place in images
    or of standard deviations, by the column there.
    """
    lone = dict[str, str]()
    deviations: dict[str, list[str]] = {}
    for column in left:
        if match := _STD.fullmatch(column):
            deviations.setdefault(match["name"], []).append(column)
        elif match := _PLACE.fullmatch(column):
            other = "v" if match["axis"] == "u" else "u"
            lone[column] = f"{column} without {match['name']}_{other} is no place in an image"
    for name, columns in deviations.items():
        beside = f"{name}_u and {name}_v, or {name}_x, {name}_y and {name}_z"
        lone |= dict.fromkeys(columns, f"{', '.join(columns)} without {beside}: of no use alone")
    return lone


def metres_per_unit(points: Array) -> float:
    """What the unit of points (N,3) is: 1 m, or 0.001 where no arm spans as many m."""
    seen = points[np.isfinite(points).all(axis=1)]
    return 1e-3 if len(seen) and np.ptp(seen, axis=0).max() > _SPAN_M else 1.0


def millimetres_note(name: str, points: Array) -> str:
    """The note on points that are in mm."""
    span = np.ptp(points[np.isfinite(points).all(axis=1)], axis=0).max()
    return f"{name}: points that span {span:.0f} cannot be in m; they are taken in mm"


def _take_track_columns(
    left: dict[str, Array], points: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, Array], list[str]]:
    """Positions (N,2) px of NAME_u and NAME_v, beside them points (N,3), and
    the standard deviations of both, removed from `left`; which of these some axes lack.
    """
    axes: dict[str, dict[str, str]] = {}
    for column in left:
        if match := _PLACE.fullmatch(column):
            axes.setdefault(match["name"], {})[match["axis"].lower()] = column
    pairs = {name: (found["u"], found["v"]) for name, found in axes.items() if len(found) == 2}
    tracks = {name: np.column_stack([left.pop(u), left.pop(v)]) for name, (u, v) in pairs.items()}
    tracks |= {name: places.copy() for name, places in points.items()}
    unseen = {name: ~np.isfinite(places).all(axis=1) for name, places in tracks.items()}
    for name, places in tracks.items():
        places[unseen[name]] = np.nan
    stds: dict[str, dict[str, str]] = {}
    for column in left:
        match = _STD.fullmatch(column)
        for name in (match["name"], f"{TRACKER}/{match['name']}") if match else ():
            if match and name in tracks:
                stds.setdefault(name, {})[(match["axis"] or match["before"] or "all").lower()] = (
                    column
                )
                break
    axes_of = {name: "xyz" if name in points else "uv" for name in stds}
    partial = [
        f"{', '.join(found.values())}: no standard deviation of {name} along {', '.join(missing)}"
        for name, found in stds.items()
        if "all" not in found and (missing := [axis for axis in axes_of[name] if axis not in found])
    ]
    both = {name: _track_std(found, left, axes_of[name]) for name, found in stds.items()}
    return tracks, both, partial


def _track_std(found: Mapping[str, str], left: dict[str, Array], axes: str) -> Array:
    """Standard deviations (N,D) from one column per axis or one for all; NaN where not positive."""
    columns = {axis: left.pop(column) for axis, column in found.items()}
    common = columns.get("all")
    unknown = np.full(len(next(iter(columns.values()))), np.nan) if common is None else common
    std = np.column_stack([columns.get(axis, unknown) for axis in axes])
    return np.where(std > 0, std, np.nan)


def _take_lens_columns(left: dict[str, Array], path: str) -> dict[str, float]:
    """The numbers of a lens, removed from `left`: LENS, and of DISTORTION and SIZE what is there.

    LogError where a number is not the same in every row, or no lens can have it.
    """
    if not set(LENS) <= set(left):
        return {}
    found = {}
    for name in (*LENS, *DISTORTION, *SIZE):
        if name not in left:
            continue
        known = left.pop(name)
        known = known[np.isfinite(known)]
        value = float(known[0]) if len(known) else 0.0
        if len(known) and np.ptp(known) > 1e-6 * max(abs(value), 1.0):
            raise LogError(
                f"{path}: column {name}: found {known.min():g} to {known.max():g}; possible: the "
                "same number in every row, for it is the camera's"
            )
        if name in ("fx", "fy") and value <= 0.0:
            raise LogError(f"{path}: column {name}: found {value:g}; possible: px, above 0")
        found[name] = value
    return found


def _find_space_columns(left: Mapping[str, Array]) -> list[str]:
    """Columns of poses in space: NAME_x, NAME_y and NAME_z together, quaternions beside them."""
    wholes = ({"x", "y", "z"}, {"qx", "qy", "qz", "qw"})
    spaces = [
        found
        for found in _axes_by_name(left).values()
        if any(whole <= set(found) for whole in wholes)
    ]
    return [column for found in spaces for column in found.values()]


def _axes_by_name(left: Mapping[str, Array]) -> dict[str, dict[str, str]]:
    """The columns of places and quaternions by axis, by the name before it."""
    axes: dict[str, dict[str, str]] = {}
    for column in left:
        if match := _SPACE.fullmatch(column):
            axes.setdefault(match["name"], {})[match["axis"].lower()] = column
    return axes


def _describe_used_columns(
    joints: Mapping[str, Array],
    tracks: Mapping[str, Array],
    images: Mapping[str, Array],
    time: str | None,
) -> list[str]:
    """The roles of the used columns; joints that may be in degrees."""
    uses = [f"joints: {', '.join(joints)}"] if joints else []
    uses += [f"tracks: {', '.join(tracks)}"] if tracks else []
    uses += [f"images: {', '.join(images)}"] if images else []
    uses += [f"time: {time}"] if time else []
    found = [f"independent poses; {'; '.join(uses)}"]
    return found


def in_degrees(joints: Mapping[str, Array]) -> list[str]:
    """Joints whose values span more than two turns: they are degrees, or not joints."""
    finite = {name: values[np.isfinite(values)] for name, values in joints.items()}
    return [name for name, values in finite.items() if values.max() > values.min() + 4.0 * np.pi]
