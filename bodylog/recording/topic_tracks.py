"""Tracks of other detectors: from topics, by type or message path, or a table beside the log."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import ConfigError, FormatError, LogError
from ..logs.decode.columns import read_topic_columns
from ..logs.decode.parts import TopicColumns
from ..logs.protocol import Log
from ..logs.tables.pose_columns import metres_per_unit, millimetres_note, read_timed_table
from ..logs.tables.table_file import FileTable
from ..settings import Settings
from ..sources import TableSource, TopicSource, track_names
from ..types import MM_PER_M, TRACK_AXES, Array, Finding, Health, Series, Topic
from .clock_steps import Times, mend_clocks
from .clocks import largest_gap, order_by_time, seconds_since, stamp_field

ENDS: Sequence[tuple[str, ...]] = (
    (".x", ".y"),
    (".u", ".v"),
    (".position.x", ".position.y"),
    (".point.x", ".point.y"),
    (".centre.x", ".centre.y"),
    (".center.x", ".center.y"),
    (".center.position.x", ".center.position.y"),
    (".bbox.center.position.x", ".bbox.center.position.y"),
    (".bbox.center.x", ".bbox.center.y"),
    (".x0", ".y0", ".x1", ".y1", ".x2", ".y2", ".x3", ".y3"),
    (".data[0]", ".data[1]", ".data[2]", ".data[3]"),
    (".data[0]", ".data[1]"),
    ("[0]", "[1]"),
)
"""Possible ends of a path: x and y, a point, a box's
centre, four corners, or u, v and their std in an array.
"""
BY_TYPE: Mapping[str, str] = {
    "apriltag_msgs/msg/AprilTagDetectionArray": ".detections[:]{id==7}.centre",
    "vision_msgs/msg/Detection2DArray": '.detections[:]{id=="hand"}.bbox.center',
    "fiducial_msgs/msg/FiducialArray": ".fiducials[:]{fiducial_id==7}",
    "foxglove_msgs/msg/ImageAnnotations": ".circles[0].position",
    "foxglove.ImageAnnotations": ".circles[0].position",
}
"""Types whose messages hold several positions, and a path to one of them."""
_ONE_POINT = "geometry_msgs/msg/PointStamped"
Read = tuple[Series, Health]
EPOCH = 1e8
"""s: later times count from 1970, earlier ones from the log's first joints."""
SPACE_ENDS = tuple(
    tuple(f"{before}{axis}" for axis in (".x", ".y", ".z"))
    for before in ("", ".point", ".position", ".pose.position", ".transform.translation")
)
"""Possible ends of a path to a point in space: those of PointStamped, PoseStamped and others."""


def find_point_topic(topics: Sequence[Topic]) -> str | None:
    """The first topic of points, with a path to one of them, that may be a marker's track, or None;
    a simulation's truth is no track.
    """
    paths = {_ONE_POINT: "", **BY_TYPE}
    points = (one for one in topics if one.type in paths and "truth" not in one.name)
    return next((one.name + paths[one.type] for one in points), None)


def read_topic_track(
    log: Log, name: str, source: TopicSource, settings: Settings, start_ns: int, late_ns: int
) -> Read:
    """A feature's positions (N,2) px, or points in space (N,3), and the
    messages' health; t in s since start_ns, `late_ns` for log times.

    LogError if the topic is missing or has no position
    at all, ConfigError for a path without positions.
    """
    topic = _require_topic(log, name, source)
    ends, found = _read_positions(log, topic, name, source)
    rows, stamps, places, rejected = _positions_of_messages(found, ends, stamp_field(topic))
    size = 2 if source.frame is None else 3
    empty = int((~np.isfinite(places[:, :size]).all(axis=1)).sum())
    if empty == len(rows):
        rejected = {**rejected, **({"not in the message": empty} if empty else {})}
        why = (
            ", ".join(f"{count} {reason}" for reason, count in rejected.items())
            or "no message can be read"
        )
        raise LogError(f"{log.path}: [features] {name}: {source.topic} shows no place: {why}")
    mended = mend_clocks({name: Times(found.log_ns[rows], stamps)})[name]
    timing = order_by_time(mended.log_ns, mended.stamp_ns, settings.time.camera)
    own = (timing.offset_ns or 0) if timing.clock == "header" else 0
    shift = own - late_ns if abs(own - late_ns) > 60_000_000_000 else 0
    values = places[timing.rows]
    std = values[:, 2:] if values.shape[1] == 4 else None
    known = std is not None and bool(np.isfinite(std).any())
    t = seconds_since(timing.t_ns + shift, start_ns)
    source_ns = found.log_ns[rows][timing.rows]
    series = (
        Series(t, values[:, :2], ("u", "v"), "px", source_ns, std if known else None)
        if source.frame is None
        else series_of_points(t, values, source_ns, None)
    )
    seen = np.isfinite(series.values).all(axis=1)
    hidden = {"not in the message": int((~seen).sum())} if not seen.all() else {}
    counts = Counter(rejected) + Counter(timing.rejected) + Counter(hidden)
    return series, Health(
        len(found.log_ns), int(seen.sum()), dict(counts), largest_gap(timing.t_ns)
    )


def _require_topic(log: Log, name: str, source: TopicSource) -> Topic:
    there = [topic for topic in log.topics if topic.name == source.topic]
    if not there:
        names = ", ".join(sorted({topic.name for topic in log.topics})[:10]) or "none"
        raise LogError(
            f"{log.path}: [features] {name}: there is no topic {source.topic!r}; possible: {names}"
        )
    return max(there, key=lambda topic: topic.messages)


def _read_positions(
    log: Log, topic: Topic, name: str, source: TopicSource
) -> tuple[tuple[str, ...], TopicColumns]:
    """Path ends that give positions, and their columns; ConfigError, with advice, if none does."""
    path = source.path or ""
    if not path and (several := BY_TYPE.get(topic.type)):
        reason = f"[features] {name}: {topic.name} ({topic.type}) holds several places; say which"
        raise ConfigError(f'{log.path}: {reason}: {{ topic = "{topic.name}", path = {several!r} }}')
    stamp = stamp_field(topic)
    problems = list[str]()
    for ends in ENDS if source.frame is None else SPACE_ENDS:
        fields = ((stamp,) if stamp else ()) + tuple((path + end).lstrip(".") for end in ends)
        try:
            found = read_topic_columns(log, topic, fields)
        except (ConfigError, FormatError) as problem:
            problems.append(str(problem))
            continue
        if any(_are_numbers(part.values) for part in found.parts):
            return ends, found
    reason = f"[features] {name}: no place at {topic.name}{path} ({topic.type})"
    why = next(
        (text for text in problems if path and path.strip(".").split("[")[0].split(".")[0] in text),
        "",
    )
    wanted = (
        "it must lead to x and y, to a point, a box, four corners or an array"
        if source.frame is None
        else "it must lead to x, y and z"
    )
    raise ConfigError(f"{log.path}: {reason}: {why or wanted}")


def _are_numbers(values: tuple[Array | tuple[str, ...], ...]) -> bool:
    return all(isinstance(value, np.ndarray) for value in values)


def _positions_of_messages(
    found: TopicColumns, ends: tuple[str, ...], stamp: str | None
) -> tuple[Array, Array | None, Array, dict[str, int]]:
    """Rows (n,), stamps (n,) or None, positions (n,2, 3
    or 4), NaN where a message has none; and rejection counts.
    """
    rows = []
    stamps = []
    places = list[Array]()
    rejected = Counter(found.rejected)
    first = int(stamp is not None)
    for part in found.parts:
        columns_ = part.values[first:]
        if not _are_numbers(columns_):
            rejected["no numbers"] += len(part.rows)
            continue
        place = _single_position(
            np.stack([np.asarray(c, float).reshape(len(part.rows), -1) for c in columns_], axis=2),
            ends,
        )
        if place is None:
            rejected["several places"] += len(part.rows)
            continue
        rows.append(part.rows)
        places.append(place)
        stamp_values = part.values[0] if first else None
        stamps.append(
            stamp_values
            if isinstance(stamp_values, np.ndarray) and stamp_values.dtype == np.int64
            else None
        )
    if not rows:
        return np.empty(0, np.int64), None, np.empty((0, 2)), dict(rejected)
    order = np.argsort(np.concatenate(rows), kind="stable")
    whole = (
        None
        if any(s is None for s in stamps)
        else np.concatenate([s for s in stamps if s is not None])[order]
    )
    return np.concatenate(rows)[order], whole, np.concatenate(places)[order], dict(rejected)


def _single_position(matches: Array, ends: tuple[str, ...]) -> Array | None:
    """The position (n,2, 3 or 4) in messages with that many
    matches (n,K,E): NaN for none, None for several.
    """
    if matches.shape[1] > 1:
        return None
    width = len(ends) if len(ends) < 8 else 2
    if not matches.shape[1]:
        return np.full((len(matches), width), np.nan)
    place = matches[:, 0]
    place = place.reshape(len(place), 4, 2).mean(axis=1) if len(ends) == 8 else place
    known = place if width == 3 else place[:, :2]
    sound: Array = np.asarray(np.isfinite(known).all(axis=1))
    return np.where(sound[:, None], place, np.nan)


def read_topic_tracks(
    log: Log, settings: Settings, start_ns: int, late_ns: int
) -> Iterator[tuple[str, Read]]:
    """Every feature of [features] from a topic."""
    for name, source in settings.features.items():
        if isinstance(source, TopicSource):
            (track,) = track_names(name, source)
            try:
                yield track, read_topic_track(log, name, source, settings, start_ns, late_ns)
            except FormatError as problem:
                raise FormatError(f"{log.path}: [features] {name}: {problem}") from None


def read_table_tracks(
    log: Path, settings: Settings, start_ns: int, end_s: float
) -> Iterator[tuple[str, tuple[Series, Health]]]:
    """Every feature of [features] from a table, t in s since start_ns; the log ends at end_s."""
    tables: dict[Path, tuple[FileTable, Array | None]] = {}
    for name, source in settings.features.items():
        if isinstance(source, TableSource):
            path = _find_table_path(log, name, source)
            if path not in tables:
                tables[path] = read_timed_table(path)
            (track,) = track_names(name, source)
            yield track, _track_from_table(path, *tables[path], name, source, start_ns, end_s)


def _find_table_path(log: Path, name: str, source: TableSource) -> Path:
    """The path of the table, as given or beside the log."""
    for path in (Path(source.table), log.parent / source.table):
        if path.is_file():
            return path
    text = f"[features] {name}: there is no table {source.table!r}, here or beside the log"
    raise LogError(f"{log}: {text}")


def _track_from_table(
    path: Path,
    table: FileTable,
    t: Array | None,
    name: str,
    source: TableSource,
    start_ns: int,
    end_s: float,
) -> tuple[Series, Health]:
    """One feature's positions (N,2) px, or points (N,3), in time order; rows at t (N,) s."""
    places, std = _position_columns(path, table, name, source)
    if t is None:
        have = ", ".join(table.names[:12])
        text = "has no column of times (t, time, stamp, unix_s, stamp_ns, ...)"
        raise ConfigError(f"{path}: [features] {name}: the table {text}; its columns are {have}")
    absolute = np.nanmedian(t) > EPOCH if np.isfinite(t).any() else False
    # whole seconds are subtracted first, to keep the microseconds of times since 1970
    t = t - start_ns // 10**9 - start_ns % 10**9 / 1e9 if absolute else t
    finite = np.isfinite(t)
    order = np.flatnonzero(finite)[np.argsort(t[finite], kind="stable")]
    order = order[np.append(True, np.diff(t[order]) > 0)] if len(order) else order
    rejected = {"no time of its own": table.rows - len(order)} if len(order) < table.rows else {}
    t = t[order]
    places = places[order]
    seen: Array = np.asarray(np.isfinite(places).all(axis=1))
    within: Array = np.asarray(seen & (t >= -1.0) & (t <= end_s + 1.0))
    if not within.any():
        span = f"{t[0]:.3f} to {t[-1]:.3f} s" if len(t) else "no row has a time"
        text = (
            f"no place within the log, which is 0 to {end_s:.3f} s; the table is {span} since "
            "the log's start"
        )
        raise LogError(f"{path}: [features] {name}: {text}")
    if not seen.all():
        rejected["empty"] = int((~seen).sum())
    source_ns = start_ns + np.rint(t * 1e9).astype(np.int64)
    values = np.where(seen[:, None], places, np.nan)
    known = None if std is None else std[order]
    found = (
        Series(t, values, ("u", "v"), "px", source_ns, known)
        if source.frame is None
        else series_of_points(t, values, source_ns, known)
    )
    gap = float(np.diff(t).max()) if len(t) > 1 else 0.0
    return found, Health(table.rows, int(seen.sum()), rejected, gap)


def _position_columns(
    path: Path, table: FileTable, name: str, source: TableSource
) -> tuple[Array, Array | None]:
    """Positions (N,2) px, or points (N,3), and their standard
    deviations: as many columns, and one or as many more for the latter.
    """
    axes = "uv" if source.frame is None else "xyz"
    size = len(axes)
    wanted = source.columns or _columns_by_feature_name(table, name, axes)
    if len(wanted) not in (size, size + 1, 2 * size):
        raise ConfigError(
            f"{path}: [features] {name}: columns must name {' and '.join(axes)}, and one or "
            f"{size} more for their std"
        )
    if missing := [column for column in wanted if column not in table.numbers]:
        have = ", ".join(table.numbers) or "none"
        raise ConfigError(
            f"{path}: [features] {name}: no column of numbers {missing[0]!r}; possible: {have}"
        )
    columns = [table.numbers[column] for column in wanted]
    places = np.column_stack(columns[:size])
    if len(columns) == size:
        return places, None
    std = np.broadcast_to(np.column_stack(columns[size:]), places.shape)
    return places, np.where(std > 0, std, np.nan)


def _columns_by_feature_name(table: FileTable, name: str, axes: str) -> tuple[str, ...]:
    """NAME_u, NAME_v and their std, or NAME_x, NAME_y, NAME_z;
    the axes alone if the table has no such columns.
    """
    there = set(table.numbers)
    for before in (f"{name}_", f"{name}.", ""):
        wanted = tuple(f"{before}{axis}" for axis in axes)
        if set(wanted) <= there:
            std = [
                columns
                for word in ("std", "sigma")
                for columns in (
                    tuple(f"{before}{word}_{axis}" for axis in axes),
                    tuple(f"{before}{axis}_{word}" for axis in axes),
                    (f"{before}{word}",),
                )
            ]
            return (*wanted, *next((some for some in std if set(some) <= there), ()))
    return tuple(f"{name}_{axis}" for axis in axes)


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
