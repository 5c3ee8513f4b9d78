"""Find a stream's stamps, select its clock; stamps out of order, duplicated or years off."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import BodylogError
from ..io.values import read_json
from ..logs.decode.columns import definition_of
from ..logs.decode.definitions import TIMES, Definition
from ..logs.records import Array, Topic

_DAY = 86_400_000_000_000
_YEAR = 366 * _DAY
_FEW = 0.1
BACK = 500_000_000
"""ns: no transport delays a message so long beyond
its successors; the clock must have run backwards.
"""
_ALONE = ("stamp", "timestamp")


class Timing(NamedTuple):
    """One stream in time order: t_ns (m,) int64 · rows
    (m,) into the input · clock used · rejected by reason.

    offset_ns, spread_s: median and 5-to-95 % range of log minus header time, None without a header.
    backwards: log times (b,) ns of messages rejected because their clock ran backwards · falls: the
    file stores the latest first.
    """

    t_ns: Array
    rows: Array
    clock: str
    rejected: Mapping[str, int]
    out_of_order: int
    offset_ns: int | None
    spread_s: float | None
    backwards: Array
    falls: bool


def order_by_time(
    log_ns: Array, stamp_ns: Array | None, choice: str, distinct: bool = True
) -> Timing:
    """Order one stream by "header", "log" or "auto" time;
    the first of equal stamps is kept if `distinct`.
    """
    t_ns = log_ns
    back = np.zeros(len(log_ns), bool)
    clock = "log"
    if stamp_ns is not None and (
        choice == "header" or (choice == "auto" and is_sound(stamp_ns, log_ns))
    ):
        if choice == "auto" and _falls_back(stamp_ns):
            back = runs_back(log_ns, stamp_ns)
        # a clock that is wrong for many messages is not used at
        # all; one that is wrong for few is used for the rest
        if back.sum() <= _FEW * len(back):
            t_ns = stamp_ns
            clock = "header"
    skipped = back.copy() if clock == "header" else np.zeros(len(back), bool)
    skipped[~skipped] = repeats_earlier_times(t_ns[~skipped])
    near = _is_near_bulk(t_ns)
    rows = np.flatnonzero(near & ~skipped)
    out_of_order = int((np.diff(t_ns[rows]) < 0).sum())
    rows = rows[np.argsort(t_ns[rows], kind="stable")]
    doubled = np.zeros(len(rows), bool)
    doubled[1:] = distinct & (np.diff(t_ns[rows]) == 0)
    counts = {
        "time years away": int((~near).sum()),
        "time runs backwards": int((near & skipped).sum()),
        "same stamp again": int(doubled.sum()),
    }
    rows = rows[~doubled]
    offset, spread = _header_offset_ns(log_ns, stamp_ns, near)
    rejected = {reason: n for reason, n in counts.items() if n}
    wrong = np.sort(log_ns[near & (back | skipped)])
    return Timing(
        t_ns[rows],
        rows,
        clock,
        rejected,
        out_of_order,
        offset,
        spread,
        wrong,
        is_stored_backwards(t_ns[near]),
    )


def _falls_back(stamp_ns: Array) -> bool:
    """Whether stamps (n,) fall in the file too: rising
    stamps are not wrong where the log's clock falls.
    """
    near = stamp_ns[_is_near_bulk(stamp_ns)]
    return bool((np.maximum.accumulate(near) - near).max(initial=0) > BACK)


def runs_back(log_ns: Array, stamp_ns: Array) -> Array:
    """Which messages (n,) got stamps apart from most when
    the header clock ran backwards relative to the log's.
    """
    near = np.flatnonzero(_is_near_bulk(stamp_ns))
    order = near[np.argsort(log_ns[near], kind="stable")]
    behind = np.maximum.accumulate(stamp_ns[order]) - stamp_ns[order]
    apart = np.zeros(len(stamp_ns), bool)
    if is_sound(log_ns) and behind.max(initial=0) > BACK:
        late = (log_ns - stamp_ns)[near]
        apart[near] = np.abs(late - np.sort(late)[len(late) // 2]) > BACK // 2
    return apart


def repeats_earlier_times(t_ns: Array) -> Array:
    """Which messages (n,) of a time-ordered file overlap
    earlier ones, because its clock was set back.
    """
    near = np.flatnonzero(_is_near_bulk(t_ns))
    again = np.zeros(len(t_ns), bool)
    t = t_ns[near]
    steps = np.diff(t)
    behind = np.maximum.accumulate(t) - t
    if behind.max(initial=0) <= BACK or np.mean(steps < 0) > _FEW or not (steps > 0).any():
        return again
    # all after the latest message so far, until a later one
    run = np.cumsum(behind == 0) - 1
    far = np.maximum.reduceat(behind, np.flatnonzero(np.diff(run, prepend=-1)))[run] > BACK
    order = np.argsort(t, kind="stable")
    between = np.full(len(t), np.iinfo(np.int64).max)
    between[order[1:-1]] = t[order[2:]] - t[order[:-2]]
    # a part written late is alone in its time range, a part with doubled times has others between
    again[near] = far & (behind > 0) & (between < 1.5 * median_by_sorting(steps[steps > 0]))
    return again


def is_stored_backwards(t_ns: Array) -> bool:
    """Whether the file stores messages from the latest to the earliest."""
    return len(t_ns) > 1 and bool(np.mean(np.diff(t_ns) < 0) > 1.0 - _FEW)


def is_sound(stamp_ns: Array, log_ns: Array | None = None) -> bool:
    """Whether header stamps are usable: mostly set, and
    moving, or duplicated at about the same log time.
    """
    if not len(stamp_ns) or np.mean(stamp_ns <= 0) > _FEW:
        return False
    different = np.count_nonzero(np.diff(np.sort(stamp_ns, kind="stable"))) + 1
    return bool(
        different > len(stamp_ns) / 2 or (log_ns is not None and _arrive_together(stamp_ns, log_ns))
    )


def _arrive_together(stamp_ns: Array, log_ns: Array) -> bool:
    """Whether messages of one stamp arrive together, as
    from two publishers, and not one after the other.
    """
    order = np.lexsort((log_ns, stamp_ns))
    stamps = stamp_ns[order]
    logged = log_ns[order]
    first = np.flatnonzero(np.diff(stamps, prepend=stamps[0] - 1))
    steps = np.diff(stamps[first])
    spans = logged[np.append(first[1:], len(stamps)) - 1] - logged[first]
    return len(steps) > 0 and median_by_sorting(spans) < 0.5 * median_by_sorting(steps)


def _is_near_bulk(t_ns: Array) -> Array:
    """True where a time is within a day of the bulk,
    unless over a tenth are not; False at time zero.

    Times over a year off are False unless most are: no log lasts that long.
    """
    order = np.argsort(t_ns, kind="stable")
    far = np.diff(t_ns[order]) > _DAY
    if not far.any():
        return np.ones(len(t_ns), bool)
    island = np.concatenate([[0], np.cumsum(far)])
    era = np.concatenate([[0], np.cumsum(np.diff(t_ns[order]) > _YEAR)])
    keep = np.empty(len(t_ns), bool)
    most = np.bincount(era, t_ns[order] > 0).argmax()
    keep[order] = (np.bincount(island) > _FEW * len(t_ns))[island] & (era == most)
    return keep & (t_ns > 0)


def _header_offset_ns(
    log_ns: Array, stamp_ns: Array | None, near: Array
) -> tuple[int | None, float | None]:
    if stamp_ns is None or not near.any():
        return None, None
    late = (log_ns - stamp_ns)[near]
    # Relative to the first: float64 would round differences of fifty years to 256 ns.
    low, middle, high = quantiles_by_sorting(late - late[0], (0.05, 0.5, 0.95))
    return int(late[0]) + round(middle), (high - low) / 1e9


def quantiles_by_sorting(values: Array, wanted: Sequence[float]) -> list[float]:
    """The quantiles of values (n,) as in `np.quantile`,
    whose import takes longer than reading a small log.
    """
    ordered = np.sort(values)
    found = np.interp(np.multiply(wanted, len(ordered) - 1), np.arange(len(ordered)), ordered)
    return [float(value) for value in found]


def median_by_sorting(values: Array) -> float:
    """The median of values (n,)."""
    return quantiles_by_sorting(values, (0.5,))[0]


def seconds_since(t_ns: Array, start_ns: int) -> Array:
    """float64 seconds since start_ns; the int64 difference comes first, to keep nanoseconds."""
    return (t_ns - np.int64(start_ns)) / 1e9


def largest_gap(t_ns: Array) -> float:
    """Longest time (s) between neighbours of an ordered stream."""
    return float(np.diff(t_ns).max() / 1e9) if len(t_ns) > 1 else 0.0


def stamp_field(topic: Topic) -> str | None:
    """Message path of the stamp: header.stamp, or a
    time called stamp or timestamp; None without one.
    """
    try:
        if topic.encoding == "json":
            return _in_schema(topic.definition)
        if topic.encoding == "protobuf":
            return _in_descriptors(topic)
        return _in_definition(definition_of(topic))
    except BodylogError:
        return None


def _in_schema(schema: bytes) -> str | None:
    try:
        properties = read_json(schema or b"{}").get("properties", {})
    except (ValueError, AttributeError):  # not JSON, or not a table
        return None
    return next(
        (name for name in _ALONE if name in properties),
        "header.stamp" if "header" in properties else None,
    )


def _in_descriptors(topic: Topic) -> str | None:
    from ..logs.decode.protobuf import field_types

    types = field_types(topic)
    return next(
        (name for name in _ALONE if types.get(name, "").endswith(("Timestamp", "Time"))), None
    )


def _in_definition(definition: Definition) -> str | None:
    for field in definition.types[definition.root]:
        if field.size is not None:
            continue
        if field.type in TIMES and field.name in _ALONE:
            return field.name
        inner = definition.types.get(field.type, ()) if field.name == "header" else ()
        if any(f.name == "stamp" and f.type in TIMES and f.size is None for f in inner):
            return "header.stamp"
    return None
