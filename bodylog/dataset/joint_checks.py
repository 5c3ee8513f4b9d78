"""Checks of an episode's joints, by their numbers as they are stored."""

from collections.abc import Iterator

import numpy as np

from ..logs.datasets.checks import value_ranges
from ..types import Array
from .reading import EpisodeReading, StoredNumbers
from .records import Measurement

SHORTEST_STUCK_S = 1.0
"""s: shorter repeats while the action moves are a joint that follows late."""
ACTION_SHARE = 0.25
"""Share of its range that an action crosses while its joint repeats one reading, for the joint to
count as stuck."""
EDGE_SHARE = 0.02
"""Distance from an end of its range, as a share of it, within which a joint may rest against a
stop."""
LEAST_CLIPPED_READINGS = 3
"""Equal readings at an end of a joint's range: fewer are a reversal."""
ABRUPT_SHARE = 0.25
"""Step into or out of a stretch at the range's end, over the joint's largest: a motion that slows
down has less."""
CLIPPED_SHARE = 0.05
"""Share of clipped readings that is reported."""
IDLE_SPEED_HZ = 0.02
"""Speed of a joint at rest, in its ranges per second: it would need 50 s to cross its range."""
IDLE_WINDOW_S = 0.2
"""s over which speeds are measured: encoders' noise and steps weigh little."""
MOVING_SHARE = 0.1
"""Range of a joint that tells motion from rest, over the widest range."""


def measure_duration(reading: EpisodeReading) -> Iterator[Measurement]:
    """Duration (s)."""
    yield Measurement("", reading.read.duration_s)


def measure_rows(reading: EpisodeReading) -> Iterator[Measurement]:
    """Readings that are no finite numbers, as a share."""
    joints = reading.joints
    if joints is None or not joints.values.size:
        return
    count = int((~np.isfinite(joints.values)).sum())
    text = (
        f"joints: {count} of {joints.values.size} readings are not finite numbers" if count else ""
    )
    yield Measurement("joints", count / joints.values.size, None, text)


def measure_stamp_jitter(reading: EpisodeReading) -> Iterator[Measurement]:
    """Standard deviation of the intervals between stamps (s): 0 where stamps are row numbers over
    the rate."""
    if reading.joints is not None and len(reading.joints.t) > 2:
        yield Measurement("joints", _interval_jitter(reading.joints.t))
    for name, film in reading.films.items():
        if film.seen is not None and len(film.seen.repeats.t) > 2:
            yield Measurement(name, _interval_jitter(film.seen.repeats.t))


def _interval_jitter(t: Array) -> float:
    """Standard deviation of intervals (s); 0 where all are alike to a microsecond, the rounding of
    stored stamps."""
    std_s = float(np.diff(t).std())
    return std_s if std_s > 1e-6 else 0.0


def measure_idle_share(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of time in which no joint moves."""
    joints = reading.joints
    if joints is None or joints.step_s <= 0.0:
        return
    ranges = value_ranges(joints.values)
    moving = ranges > MOVING_SHARE * ranges.max(initial=0.0)
    width = max(1, round(IDLE_WINDOW_S / joints.step_s))
    if not moving.any() or len(joints.t) <= width:
        return
    steps = np.abs(joints.values[width:, moving] - joints.values[:-width, moving])
    speeds = steps / ranges[moving] / (width * joints.step_s)
    yield Measurement("", float(np.mean((np.nan_to_num(speeds) < IDLE_SPEED_HZ).all(axis=1))))


def measure_longest_repeats(reading: EpisodeReading) -> Iterator[Measurement]:
    """Longest time (s) that a joint repeats one reading while others move; nothing of joints that
    never move."""
    joints = reading.joints
    if joints is None or joints.step_s <= 0.0:
        return
    ranges = value_ranges(joints.values)
    others_move = _moving_rows(joints)
    for number, name in enumerate(joints.names):
        if ranges[number] == 0.0:
            continue
        y = joints.values[:, number]
        runs = [run for run in equal_runs(y) if others_move[run[0] : run[1]].mean() > 0.5]
        if not runs:
            yield Measurement(name, 0.0)
            continue
        first, last = max(runs, key=lambda run: run[1] - run[0])
        yield Measurement(name, float(joints.t[last] - joints.t[first]), at=float(y[first]))


def measure_joint_standstills(reading: EpisodeReading) -> Iterator[Measurement]:
    """Longest time (s) for which a joint's action moves while the joint repeats one reading."""
    joints = reading.joints
    action = reading.action
    if joints is None or action is None or joints.step_s <= 0.0 or len(action.t) != len(joints.t):
        return
    ranges = value_ranges(joints.values)
    width = max(1, round(IDLE_WINDOW_S / joints.step_s))
    for number, name in enumerate(joints.names):
        if ranges[number] == 0.0 or name not in action.names:
            continue
        wanted = action.values[:, action.names.index(name)]
        least = IDLE_SPEED_HZ * width * joints.step_s * value_ranges(wanted[:, None])[0]
        moving = np.nan_to_num(np.abs(wanted[width:] - wanted[:-width])) > least
        y = joints.values[:, number]
        standstills = [
            (float(moving[first:last].sum()), first, last) for first, last in equal_runs(y)
        ]
        rows, first, last = max(standstills, default=(0.0, 0, 0))
        text = _describe_standstill(joints, number, first, last, wanted)
        yield Measurement(name, rows * joints.step_s, None, text, at=float(y[first]))


def _moving_rows(joints: StoredNumbers) -> Array:
    """Rows (N,) in which some joint moves faster than at rest."""
    ranges = value_ranges(joints.values)
    known = ranges > 0.0
    steps = np.abs(np.diff(joints.values[:, known], axis=0)) / ranges[known] / joints.step_s
    moving = np.asarray((np.nan_to_num(steps) > IDLE_SPEED_HZ).any(axis=1))
    return np.append(moving, moving[-1:])


def _describe_standstill(
    joints: StoredNumbers, number: int, first: int, last: int, wanted: Array
) -> str:
    """What an action wanted (N,) that moves says of a joint that repeats its reading in rows first
    to last."""
    if joints.t[last] - joints.t[first] < SHORTEST_STUCK_S:
        return ""
    y = joints.values[:, number]
    low = float(np.nanmin(y))
    high = float(np.nanmax(y))
    inside = min(y[first] - low, high - y[first]) > EDGE_SHARE * (high - low)
    crossed = float(np.ptp(wanted[first : last + 1]))
    if not inside or crossed < ACTION_SHARE * float(np.ptp(wanted)):
        return ""
    when = f"from {joints.t[first]:.2f} to {joints.t[last]:.2f} s"
    text = f"{joints.names[number]}: repeats {y[first]:.4g} {when}"
    return f"{text} while its action moves by {crossed:.3g}"


def equal_runs(y: Array) -> list[tuple[int, int]]:
    """Runs (first, last) of two and more equal readings y (N,)."""
    edges = np.flatnonzero(np.diff(np.diff(y) == 0.0, prepend=False, append=False)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def measure_clipped_joints(reading: EpisodeReading) -> Iterator[Measurement]:
    """Share of readings in stretches at exactly an end of a joint's range that it enters or leaves
    abruptly."""
    joints = reading.joints
    if joints is None:
        return
    for name, y in zip(joints.names, joints.values.T, strict=True):
        if len(y) < LEAST_CLIPPED_READINGS or not np.isfinite(y).all() or np.ptp(y) == 0.0:
            continue
        steps = np.abs(np.diff(y))
        abrupt = ABRUPT_SHARE * float(steps.max())
        at_ends: dict[float, int] = {}
        for first, last in equal_runs(y):
            at_end = y[first] in (y.min(), y.max()) and last - first + 1 >= LEAST_CLIPPED_READINGS
            beside = max(
                steps[first - 1] if first > 0 else 0.0, steps[last] if last < len(steps) else 0.0
            )
            if at_end and beside >= abrupt:
                at_ends[float(y[first])] = at_ends.get(float(y[first]), 0) + last - first + 1
        share = sum(at_ends.values()) / len(y)
        most = max(at_ends, key=lambda value: at_ends[value], default=float("nan"))
        where = "exactly at an end of its range: a stop, or clipped"
        text = f"{name}: {100.0 * share:.0f} % of readings are {where}"
        text = text if share >= CLIPPED_SHARE else ""
        yield Measurement(name, share, None, text, "info", at=most)


def measure_jumps(reading: EpisodeReading) -> Iterator[Measurement]:
    """Shifts in the level of a joint's readings that are faster than any joint moves; of joints in
    rad."""
    from ..estimation.faults.jumping import find_jumps

    joints = reading.read.signals.joints
    if joints is None or joints.unit != "rad":
        return
    for name, y in zip(joints.names, joints.values.T, strict=True):
        finite = np.isfinite(y)
        found = find_jumps(joints.t[finite], y[finite]) if finite.sum() > 2 else []
        text = ""
        if found:
            at, size, std = found[0]
            more = f", and {len(found) - 1} more" if len(found) > 1 else ""
            text = (
                f"{name}: jumps by {size:.3g} ± {std:.1g} rad at {joints.t[finite][at]:.2f} s{more}"
            )
        yield Measurement(name, float(len(found)), None, text)


def measure_still_joints(reading: EpisodeReading) -> Iterator[Measurement]:
    """1 for a joint that never moves in the episode, else 0."""
    if reading.joints is not None:
        ranges = value_ranges(reading.joints.values)
        for name, span in zip(reading.joints.names, ranges.tolist(), strict=True):
            yield Measurement(name, float(span == 0.0))


def measure_starts(reading: EpisodeReading) -> Iterator[Measurement]:
    """The posture of the first row, in the joints' unit."""
    if reading.joints is not None and len(reading.joints.values):
        for name, value in zip(
            reading.joints.names, reading.joints.values[0].tolist(), strict=True
        ):
            yield Measurement(name, value)


def measure_means(reading: EpisodeReading) -> Iterator[Measurement]:
    """The mean of each joint, in its unit."""
    for name, y in _finite_columns(reading.joints):
        yield Measurement(name, float(y.mean()))


def measure_sizes(reading: EpisodeReading) -> Iterator[Measurement]:
    """Logarithm of each joint's root mean square: a wrong unit shifts it by a constant."""
    for name, y in _finite_columns(reading.joints):
        size = float(np.sqrt(np.mean(y**2)))
        if size > 0.0:
            yield Measurement(name, float(np.log(size)))


def measure_row_counts(reading: EpisodeReading) -> Iterator[Measurement]:
    """Rows that the dataset lists but the table does not hold, as a share; the reader says so in
    words."""
    if reading.declared_rows:
        yield Measurement("", abs(reading.rows - reading.declared_rows) / reading.declared_rows)


def _finite_columns(joints: StoredNumbers | None) -> Iterator[tuple[str, Array]]:
    if joints is None:
        return
    for name, column in zip(joints.names, joints.values.T, strict=True):
        finite = column[np.isfinite(column)]
        if len(finite):
            yield name, finite
