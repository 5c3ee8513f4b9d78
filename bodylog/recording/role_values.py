"""Columns to one signal: joints by name, arrays side by side; what does not fit is counted."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import LogError
from ..io.values import reject_impossible
from ..logs.decode.parts import TopicColumns
from ..logs.limits import LIMITS, Input, TableSize
from ..logs.records import Array

_TURN = 2.0 * np.pi
_NEAR = 1.0 / _TURN
"""Turns, one radian, by which a step may differ from a whole turn when a joint wraps."""


class JointNameSet(NamedTuple):
    """The messages, by their rows (k,), that name these joints, in any order."""

    names: tuple[str, ...]
    rows: Array


class RoleSignal(NamedTuple):
    """Rows (m,) into the messages read · stamp_ns (m,) or
    None · values (m,D) · names (D,) · rejected by reason.

    sets: the messages by the joints they name, the most frequent first.
    """

    rows: Array
    stamp_ns: Array | None
    values: Array
    names: tuple[str, ...]
    rejected: Mapping[str, int]
    sets: tuple[JointNameSet, ...] = ()


Block = tuple[Array, Array | None, tuple[Array | tuple[str, ...], ...]]
"""Rows, stamps and the remaining fields of messages of one shape."""


def read_blocks(
    columns: Sequence[TopicColumns], stamp: str | None, fields: Sequence[str]
) -> Iterator[Block]:
    """The parts of several topics of one name, with rows counted through all of them."""
    first = 0
    for some in columns:
        places = [some.fields.index(name) for name in fields]
        for part in some.parts:
            found = part.values[some.fields.index(stamp)] if stamp in some.fields else None
            times = found if isinstance(found, np.ndarray) and found.dtype == np.int64 else None
            stamps = times if times is not None and times.ndim == 1 else None
            yield part.rows + first, stamps, tuple(part.values[p] for p in places)
        first += len(some.log_ns)


def joints_by_name(
    found: Sequence[Block],
    wanted: tuple[str, ...] | None,
    what: str,
    every: bool = True,
    limits: Input = LIMITS,
) -> RoleSignal:
    """Named joints (names, positions): values by name,
    NaN where a message lacks one or names it twice.

    LogError when `every` wanted joint must exist and
    one does not, or when the joints have no names.
    """
    rejected: Counter[str] = Counter()
    good = []
    for rows, stamps, (names, positions) in sorted(found, key=lambda block: int(block[0].min())):
        if not isinstance(names, tuple) or not isinstance(positions, np.ndarray):
            wrong = (
                "names that are not texts"
                if isinstance(positions, np.ndarray)
                else "positions that are not numbers"
            )
            rejected[wrong] += len(rows)
            continue
        # a single joint is one number per message in JSON
        positions = positions.reshape(len(rows), -1)
        if not names and positions.shape[1]:
            names = _names_for_nameless(positions.shape[1], wanted, what)
        if len(names) != positions.shape[1] or not names:
            rejected[_reason_joints_unfit(len(names), positions.shape[1])] += len(rows)
            continue
        names, positions = _without_duplicates(names, positions)
        if not names:
            rejected["every joint is named more than once"] += len(rows)
            continue
        good.append((rows, stamps, names, positions))
    order = _order_of_joints([names for _, _, names, _ in good], wanted, what, every)
    if len(order) > limits.max_joints:
        asked = f"to read them, type in robot.toml: [input] max_joints = {len(order)}"
        raise LogError(
            f"{what}: its messages name {len(order)} joints, at most {limits.max_joints} are "
            f"read; {asked}"
        )
    TableSize(limits).take(
        8 * len(order) * sum(len(rows) for rows, *_ in good), f"{what}: {len(order)} joints"
    )
    values = [_columns_in_order(names, positions, order) for _, _, names, positions in good]
    return _join_blocks([(r, s) for r, s, _, _ in good], values, order, rejected)._replace(
        sets=_name_sets(good)
    )


def _name_sets(
    good: Sequence[tuple[Array, Array | None, tuple[str, ...], Array]],
) -> tuple[JointNameSet, ...]:
    """Messages by the joints they name, in any order, the most frequent first."""
    lists: dict[frozenset[str], tuple[tuple[str, ...], list[Array]]] = {}
    for some, _, names, _ in good:
        lists.setdefault(frozenset(names), (names, []))[1].append(some)
    most_first = sorted(lists.values(), key=lambda one: -sum(map(len, one[1])))
    return tuple(JointNameSet(names, np.concatenate(rows)) for names, rows in most_first)


def _reason_joints_unfit(names: int, positions: int) -> str:
    if names and positions:
        return f"{positions} positions for {names} names"
    return "no positions" if names else "no joints"


def _without_duplicates(names: tuple[str, ...], positions: Array) -> tuple[tuple[str, ...], Array]:
    """Drop joints that one message names twice: which position is theirs is unknown."""
    if len(set(names)) == len(names):
        return names, positions
    counts = Counter(names)
    kept = [place for place, name in enumerate(names) if counts[name] == 1]
    return tuple(names[place] for place in kept), positions[:, kept]


def _names_for_nameless(count: int, wanted: tuple[str, ...] | None, what: str) -> tuple[str, ...]:
    if wanted is None:
        raise LogError(
            f"{what}: the {count} joints have no names; type in robot.toml: [body] joints = "
            f"[{count} names]"
        )
    if len(wanted) != count:
        text = f"[body] joints names {len(wanted)}; name all {count}"
        raise LogError(f"{what}: the {count} joints have no names, but {text}")
    return wanted


def _order_of_joints(
    seen: Sequence[tuple[str, ...]], wanted: tuple[str, ...] | None, what: str, every: bool
) -> tuple[str, ...]:
    there = tuple(dict.fromkeys(name for names in seen for name in names))
    if wanted is None or not there:
        return wanted or there
    unknown = [name for name in wanted if name not in there]
    if unknown and every:
        raise LogError(
            f"{what}: [body] joints names {unknown[0]!r}; the log has {', '.join(sorted(there))}"
        )
    return tuple(name for name in wanted if name in there)


def _columns_in_order(names: tuple[str, ...], positions: Array, order: tuple[str, ...]) -> Array:
    if names == order:
        return positions
    values = np.full((len(positions), len(order)), np.nan)
    columns = {name: place for place, name in enumerate(order)}
    for place, name in enumerate(names):
        if name in columns:
            values[:, columns[name]] = positions[:, place]
    return values


def unwrap_angles(values: Array, turn: float | None = _TURN) -> tuple[Array, int, Array]:
    """Angles (N,D) rad unwrapped, without readings beyond
    FARTHEST; the number of these; turns removed (D,).

    A step of a whole turn, within a radian, is a wrap. Independent poses (`turn` None) are not
    unwrapped. `turn`: one turn in the values' unit.
    """
    values, beyond = reject_impossible(values)
    values = values.copy()
    turns = np.zeros(values.shape[1], int)
    whole = turn or _TURN
    for column in range(0 if turn is None else values.shape[1]):
        known = np.flatnonzero(np.isfinite(values[:, column]))
        steps = np.diff(values[known, column])
        wraps = np.where(np.abs(np.abs(steps) / whole - 1.0) < _NEAR, np.sign(steps), 0.0)
        if wraps.any():
            values[known[1:], column] -= whole * np.cumsum(wraps)
            turns[column] = np.count_nonzero(wraps)
    return values, beyond, turns


def signal_of_arrays(found: Sequence[Block]) -> RoleSignal:
    """Arrays of numbers of the most common width;
    others are rejected, and all if none holds a number.
    """
    widths: Counter[int] = Counter()
    shaped = []
    texts_ = 0
    for rows, stamps, (values,) in found:
        if isinstance(values, np.ndarray):
            flat = values.reshape(len(values), -1)
            widths[flat.shape[1]] += len(rows)
            shaped.append((rows, stamps, flat))
        else:
            texts_ += len(rows)
    width = widths.most_common(1)[0][0] if widths else 0
    rejected = Counter({f"{w} values, not {width}": n for w, n in widths.items() if w != width})
    rejected.update({"values that are not numbers": texts_} if texts_ else {})
    good = [(r, s, v) for r, s, v in shaped if v.shape[1] == width and width]
    if widths and not width:
        rejected["empty array"] = widths[0]
    names = tuple(str(cell) for cell in range(width))
    if good and all(np.isnan(values).all() for _, _, values in good):
        rejected["no number in it"] = sum(len(rows) for rows, _, _ in good)
        good = []
    return _join_blocks([(r, s) for r, s, _ in good], [v for _, _, v in good], names, rejected)


def reject_non_proximities(signal: RoleSignal) -> RoleSignal:
    """The signal if all its values lie within 0..1, otherwise with all rejected."""
    values = signal.values
    if np.all(np.isnan(values) | ((values >= 0) & (values <= 1))):
        return signal
    reason = {"values beyond 0..1 on a topic whose name does not contain skin": len(signal.rows)}
    return RoleSignal(
        signal.rows[:0], None, values[:0], signal.names, {**signal.rejected, **reason}
    )


def signal_of_texts(found: Sequence[Block], refused: Mapping[str, str | None]) -> RoleSignal:
    """Messages by one text (an image's encoding); those
    that `refused` gives a reason for are rejected.
    """
    rejected: Counter[str] = Counter()
    good = []
    for rows, stamps, (text,) in found:
        reason = refused.get(str(text[0]) if len(text) else "", None)
        if reason is None:
            good.append((rows, stamps))
        else:
            rejected[reason] += len(rows)
    return _join_blocks(good, [np.empty((len(rows), 0)) for rows, _ in good], (), rejected)


def _join_blocks(
    places: Sequence[tuple[Array, Array | None]],
    values: Sequence[Array],
    names: tuple[str, ...],
    rejected: Counter[str],
) -> RoleSignal:
    if not places:
        return RoleSignal(
            np.empty(0, np.int64), None, np.empty((0, len(names))), names, dict(rejected)
        )
    rows = np.concatenate([r for r, _ in places])
    joined = np.concatenate(values)
    stamps = [s for _, s in places if s is not None]
    stamp_ns = np.concatenate(stamps) if len(stamps) == len(places) else None
    if (np.diff(rows) < 0).any():
        order = np.argsort(rows, kind="stable")
        rows = rows[order]
        joined = joined[order]
        stamp_ns = None if stamp_ns is None else stamp_ns[order]
    return RoleSignal(rows, stamp_ns, joined, names, dict(rejected))


def merge_equal_stamps(t_ns: Array, values: Array) -> tuple[Array, Array, int]:
    """Rows to keep (n,) with unique stamps · values (n,D) · how many messages added nothing.

    Later messages of the same stamp (the other half of the joints) fill NaN of the first.
    """
    keep = np.concatenate([[True], np.diff(t_ns) != 0]) if len(t_ns) else np.ones(0, bool)
    if keep.all():
        return keep, values, 0
    first = np.maximum.accumulate(np.where(keep, np.arange(len(keep)), 0))
    values = values.copy()
    idle = 0
    for row in np.flatnonzero(~keep):
        target = values[first[row]]
        new = np.isnan(target) & ~np.isnan(values[row])
        target[new] = values[row][new]
        idle += not new.any()
    return keep, values, idle
