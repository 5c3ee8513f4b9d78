"""Which clock dates a stream, and what to do with stamps that are out of order, doubled or years away."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..types import Array

_DAY = 86_400_000_000_000
_FEW = 0.1


@dataclass(frozen=True, eq=False)
class Dated:
    """One stream in time order: t_ns (m,) int64 · rows (m,) into what was given · which clock · rejected by reason.

    offset_ns, spread_s: median and 5-to-95 % range of log minus header time, None without a header.
    """

    t_ns: Array
    rows: Array
    clock: str
    rejected: Mapping[str, int]
    out_of_order: int
    offset_ns: int | None
    spread_s: float | None


def date(log_ns: Array, stamp_ns: Array | None, choice: str, distinct: bool = True) -> Dated:
    """Order one stream by "header", "log" or "auto" time; of equal stamps the first is kept if `distinct`."""
    header = stamp_ns is not None and (choice == "header" or (choice == "auto" and is_sound(stamp_ns)))
    t_ns = stamp_ns if header and stamp_ns is not None else log_ns
    near = _near(t_ns)
    rows = np.flatnonzero(near)
    out_of_order = int((np.diff(t_ns[rows]) < 0).sum())
    rows = rows[np.argsort(t_ns[rows], kind="stable")]
    doubled = np.zeros(len(rows), bool)
    doubled[1:] = distinct & (np.diff(t_ns[rows]) == 0)
    counts = {"time years away": int((~near).sum()), "same stamp again": int(doubled.sum())}
    rows = rows[~doubled]
    offset, spread = _offset(log_ns, stamp_ns, near)
    rejected = {reason: n for reason, n in counts.items() if n}
    return Dated(t_ns[rows], rows, "header" if header else "log", rejected, out_of_order, offset, spread)


def is_sound(stamp_ns: Array) -> bool:
    """Whether header stamps can be used: mostly set, and moving."""
    if not len(stamp_ns) or np.mean(stamp_ns <= 0) > _FEW:
        return False
    different = np.count_nonzero(np.diff(np.sort(stamp_ns, kind="stable"))) + 1
    return bool(different > len(stamp_ns) / 2)


def _near(t_ns: Array) -> Array:
    """True where a time belongs to the bulk: more than a day off, a tenth or less, or at time zero, does not."""
    order = np.argsort(t_ns, kind="stable")
    far = np.diff(t_ns[order]) > _DAY
    if not far.any():
        return np.ones(len(t_ns), bool)
    island = np.concatenate([[0], np.cumsum(far)])
    keep = np.empty(len(t_ns), bool)
    keep[order] = (np.bincount(island) > _FEW * len(t_ns))[island]
    return keep & (t_ns > 0)


def _offset(log_ns: Array, stamp_ns: Array | None, near: Array) -> tuple[int | None, float | None]:
    if stamp_ns is None or not near.any():
        return None, None
    late = (log_ns - stamp_ns)[near]
    # Relative to the first, or the float64 of clocks fifty years apart would round to 256 ns.
    low, middle, high = np.percentile(late - late[0], [5, 50, 95])
    return int(late[0]) + round(middle), float(high - low) / 1e9


def seconds(t_ns: Array, start_ns: int) -> Array:
    """float64 seconds since start_ns, differenced in int64 first so that nanoseconds survive."""
    return (t_ns - np.int64(start_ns)) / 1e9


def largest_gap(t_ns: Array) -> float:
    """Longest time (s) between neighbours of an ordered stream."""
    return float(np.diff(t_ns).max() / 1e9) if len(t_ns) > 1 else 0.0
