"""Tracks from a table beside the log: rows of time, u and v from a keypoint
network or a person, or x, y and z from motion capture.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import ConfigError, LogError
from ..logs.tables.pose_columns import time_column
from ..logs.tables.table_file import FileTable, read_table_file, table_format
from ..settings import Settings
from ..sources import TableSource, track_names
from ..types import Array, Health, Series
from .space_points import series_of_points

EPOCH = 1e8
"""s: later times count from 1970, earlier ones from the log's first joints."""


def read_table_tracks(
    log: Path, settings: Settings, start_ns: int, end_s: float
) -> Iterator[tuple[str, tuple[Series, Health]]]:
    """Every feature of [features] from a table, t in s since start_ns; the log ends at end_s."""
    read_: dict[Path, FileTable] = {}
    for name, source in settings.features.items():
        if isinstance(source, TableSource):
            path = _find_table_path(log, name, source)
            if path not in read_:
                with path.open("rb") as stream:
                    read_[path] = read_table_file(path, table_format(path, stream.read(4)) or "csv")
            (track,) = track_names(name, source)
            yield track, _track_from_table(path, read_[path], name, source, start_ns, end_s)


def _find_table_path(log: Path, name: str, source: TableSource) -> Path:
    """The path of the table, as given or beside the log."""
    for path in (Path(source.table), log.parent / source.table):
        if path.is_file():
            return path
    text = f"[features] {name}: there is no table {source.table!r}, here or beside the log"
    raise LogError(f"{log}: {text}")


def _track_from_table(
    path: Path, table: FileTable, name: str, source: TableSource, start_ns: int, end_s: float
) -> tuple[Series, Health]:
    """One feature's positions (N,2) px, or points (N,3), in time order."""
    places, std = _position_columns(path, table, name, source)
    column, t = time_column(table.numbers)
    if column is None:
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
