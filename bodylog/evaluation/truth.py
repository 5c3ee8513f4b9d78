"""True angles kept beside a log: a table (.csv) with a
time column and the joints by name, or arrays (.npz).
"""

import csv
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io import atomic_files
from ..types import Array, Poses, Series

MOST_BYTES = 1 << 30
"""Bytes that a table, or the arrays of an archive once unpacked, may have."""
TIMES = (
    "t",
    "time",
    "timestamp",
    "stamp",
    "t_ns",
    "time_ns",
    "timestamp_ns",
    "stamp_ns",
    "t_s",
    "time_s",
    "seconds",
)
NAMES = ("names", "joints", "joint_names")
ANGLES = ("q", "positions", "position")
STARTS = ("start", "start_ns", "T0")
"""Columns and arrays that are looked for, in order."""
PLACE = ("x", "y", "z")
TURN = ("qx", "qy", "qz", "qw")
"""Columns of a table of poses."""
EPOCH_UNITS = ((1e17, 1.0), (1e14, 1e3), (1e11, 1e6), (1e8, 1e9))
"""From which number on a time is one since 1970, and
its unit in ns; smaller ones are s since the log began.
"""
SURE = 0.5
SAME = 0.01
"""Share of the distance to any other column by which a joint must be nearer to its own, and how far
apart (rad) columns must be for that."""


def load_truth(path: Path, start_ns: int, joints: Series | None) -> Series:
    """The truth in a file, t in s since `start_ns`; an archive's
    unnamed columns are matched to the readings `joints`.

    InputError where it is no such file, or has no times or no angles.
    """
    try:
        found = (
            _read_truth_archive(path, start_ns, joints)
            if path.suffix == ".npz"
            else _read_truth_table(path, start_ns)
        )
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        zipfile.BadZipFile,
        csv.Error,
        EOFError,
    ) as err:
        raise InputError(
            f"{path}: no truth can be read from it ({err}); {_describe_possible_truth()}"
        ) from None
    if not len(found.t) or not np.isfinite(found.t).all() or not np.isfinite(found.values).any():
        raise InputError(
            f"{path}: {len(found.t)} rows, but not with numbers for times and angles; "
            f"{_describe_possible_truth()}"
        )
    order = np.argsort(found.t, kind="stable")
    return Series(found.t[order], found.values[order], found.names, "rad", found.source_ns[order])


def load_poses(path: Path, start_ns: int) -> Poses | None:
    """The effector's poses in a table (.csv): columns x, y, z
    (m, in the robot's base), and qx, qy, qz, qw or no turn.

    t in s since `start_ns`; each name may begin with effector_. None where the file is no table or
    has no x, y, z; InputError where it has, and no times or numbers.
    """
    if path.suffix != ".csv":
        return None
    try:
        rows = _read_truth_table(path, start_ns)
    except (OSError, ValueError, csv.Error) as err:
        raise InputError(
            f"{path}: no truth can be read from it ({err}); {_describe_possible_truth()}"
        ) from None
    columns = {
        name.removeprefix("effector_"): rows.values[:, k] for k, name in enumerate(rows.names)
    }
    if not set(PLACE) <= set(columns):
        return None
    place = np.column_stack([columns[name] for name in PLACE])
    turn = np.full((len(place), 4), np.nan)
    if set(TURN) <= set(columns):
        turn = np.column_stack([columns[name] for name in TURN])
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    sound = np.isfinite(place).all(axis=1) & np.isfinite(rows.t)
    if not sound.any():
        raise InputError(
            f"{path}: {len(place)} rows, but not with numbers for times and x, y, z; "
            f"{_describe_possible_truth()}"
        )
    order = np.flatnonzero(sound)[np.argsort(rows.t[sound], kind="stable")]
    return Poses(rows.t[order], place[order], turn[order], "", rows.source_ns[order])


def _describe_possible_truth() -> str:
    return (
        "possible: a .csv with a column t (s since the log's first joint reading, or since "
        "1970 in s, ms, µs, ns) and "
        "one in rad for each joint by its name, or x, y, z in m; an .npz with arrays t, q "
        "and names; or a log"
    )


def _read_truth_table(path: Path, start_ns: int) -> Series:
    rows = list(csv.reader(atomic_files.read_limited_text(path, MOST_BYTES).splitlines()))
    if len(rows) < 2:
        raise ValueError(f"{len(rows)} lines")
    header = [name.strip() for name in rows[0]]
    time = _find_time_name(TIMES, header)
    bad = next((k for k, row in enumerate(rows[1:], 2) if len(row) != len(header)), None)
    if bad is not None:
        raise ValueError(
            f"line {bad} has {len(rows[bad - 1])} columns, the first has {len(header)}"
        )
    others = tuple(name for name in header if name != time)
    times = [row[header.index(time)].strip() for row in rows[1:]]
    cells = [[_parse_cell(row[header.index(name)]) for name in others] for row in rows[1:]]
    values = np.array(cells).reshape(len(times), -1)
    return Series(
        _seconds_since_start(times, start_ns), values, others, "rad", np.zeros(len(times), np.int64)
    )


def _parse_cell(text: str) -> float:
    """A cell; what is empty, or no number, is not known."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _read_truth_archive(path: Path, start_ns: int, joints: Series | None) -> Series:
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > MOST_BYTES:
        raise ValueError(f"{size} bytes unpacked, at most {MOST_BYTES} are read")
    with np.load(path, allow_pickle=False) as archived:
        arrays = {name: archived[name] for name in archived.files}
    t = np.asarray(arrays[_find_time_name(TIMES, list(arrays))]).ravel()
    begin = next((name for name in STARTS if name in arrays), None)
    if begin is not None and abs(float(t.max(initial=0.0))) < EPOCH_UNITS[-1][0]:
        t = t.astype(float) + (int(arrays[begin]) - start_ns) / 1e9
    else:
        t = _seconds_since_start([str(one) for one in t.tolist()], start_ns)
    values, names = _truth_angles(arrays, t, joints)
    return Series(t, values, names, "rad", np.zeros(len(t), np.int64))


def _truth_angles(
    arrays: Mapping[str, Array], t: Array, joints: Series | None
) -> tuple[Array, tuple[str, ...]]:
    """Angles (N,M) and their joints' names."""
    known = () if joints is None else joints.names
    if single := tuple(name for name in known if name in arrays):
        return np.stack(
            [np.asarray(arrays[name], float).ravel() for name in single], axis=1
        ), single
    values = np.asarray(arrays[_find_time_name(ANGLES, list(arrays))], float)
    if values.ndim != 2 or len(values) != len(t):
        raise ValueError(f"angles are of shape {values.shape}, times {t.shape}")
    given = next(
        (arrays[name] for name in NAMES if name in arrays and arrays[name].dtype.kind == "U"), None
    )
    if given is not None:
        if given.shape != (values.shape[1],):
            raise ValueError(f"{given.shape[0]} names for {values.shape[1]} columns")
        return values, tuple(str(name) for name in given)
    return values, _names_by_readings(values, t, joints)


def _names_by_readings(values: Array, t: Array, joints: Series | None) -> tuple[str, ...]:
    """Names of the columns (N,M), by which joint's readings
    they follow; ValueError where that is not plain.
    """
    from scipy.optimize import linear_sum_assignment

    if joints is None or len(joints.names) != values.shape[1]:
        have = "no joints" if joints is None else f"{len(joints.names)} joints"
        raise ValueError(
            f"{values.shape[1]} columns without names, the log has {have}; add an array names"
        )
    read = np.stack(
        [
            np.interp(t, joints.t[ok], c[ok])
            for c, ok in ((c, np.isfinite(c)) for c in joints.values.T)
        ]
    )
    apart = np.sqrt(np.nanmean(np.square(read[:, :, None] - values[None]), axis=1))
    rows, columns = linear_sum_assignment(apart)
    own = rows[np.argsort(columns)]
    beside = apart[own, np.arange(len(own))]
    # columns that are the same may be exchanged
    differ = np.sqrt(np.nanmean(np.square(values[:, :, None] - values[:, None]), axis=0))
    near = (apart[own] < beside[:, None] / SURE) & (differ > SAME)
    if near.any():
        raise ValueError(
            "columns without names, and the log's readings do not tell whose they are; add "
            "an array names"
        )
    return tuple(joints.names[k] for k in own)


def _find_time_name(possible: tuple[str, ...], found: list[str]) -> str:
    for name in possible:
        if name in found:
            return name
    raise ValueError(f"found {', '.join(found[:20])}; one of {', '.join(possible)} is needed")


def _seconds_since_start(times: list[str], start_ns: int) -> Array:
    """Times (N,) s since start_ns; whole numbers of ns
    are taken as they are, for a float would round them.
    """
    first = abs(float(times[0])) if times else 0.0
    unit = next((ns for least, ns in EPOCH_UNITS if first > least), None)
    if unit is None:
        return np.array([float(one) for one in times])
    if unit == 1.0 and all(one.lstrip("-").isdigit() for one in times):
        return np.array([(int(one) - start_ns) / 1e9 for one in times])
    return np.array([float(one) * unit / 1e9 - start_ns / 1e9 for one in times])
