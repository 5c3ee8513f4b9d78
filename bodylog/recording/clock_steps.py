"""Clocks that are set while a log is recorded: where, and by how much.

ntpd sets a clock that is over 128 ms off, and chrony whatever its `makestep` says. The recorder's
clock shows a step back as log times that fall in the file; a sensor's clock as stamps that fall
while log times go on. A sensor's clock was set forward where its stamps leap from the present into
the future; those that leap to the present may be what follows a backlog that was dropped.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from ..logs.records import Array
from .clocks import median_by_sorting

LEAST_STEP_NS = 20_000_000
"""ns: least fall or leap that counts as a step."""
MOST_STEP_NS = 86_400_000_000_000
"""ns: a stamp that falls by a day or more is wrong, not late."""
WINDOW = 100
"""Most messages on each side of a step by which its size is measured."""
LASTING = 30
"""Messages most of which must follow a step on the clock that was set, unless the log ends."""
FEWEST = 3
"""Fewest messages on each side of a step."""
MOST_FALLS = 16
"""A stream that falls more often is out of order: no clock is set that often."""
SAME_STEP_NS = 1_000_000_000
"""ns: steps of two streams within this time may be one step of one clock."""
SAME_SIZE_NS = 5_000_000
"""ns: sizes of one step in two streams differ by no more, beside five standard errors."""
STEADY_SHARE = 0.25
"""Largest scatter of a level, and difference between two levels, as a share of the step."""


class ClockStep(NamedTuple):
    """A clock that was set back by_ns ± std_ns before the message `row`; negative: set forward.

    at_ns: the log time of the last message before it.
    """

    clock: Literal["log", "header"]
    row: int
    at_ns: int
    by_ns: int
    std_ns: float


class Times(NamedTuple):
    """Log times and stamps (n,) ns of one stream in the file's order, and the rows at which a
    further topic begins.
    """

    log_ns: Array
    stamp_ns: Array | None
    begins: tuple[int, ...] = ()


class Mended(NamedTuple):
    """Log times and stamps (n,) ns on the clocks before their steps, and the steps."""

    log_ns: Array
    stamp_ns: Array | None
    steps: tuple[ClockStep, ...] = ()


def mend_clocks(streams: Mapping[str, Times]) -> dict[str, Mended]:
    """Take the steps of the recorder's clock, then those of each stream's own, out of the times of
    all streams.
    """
    log_steps = _found_or_adopted(streams, _find_log_steps, _adopt_log_steps)
    logged = {
        name: times._replace(log_ns=_without_steps(times.log_ns, log_steps[name], times.begins))
        for name, times in streams.items()
    }
    header_steps = _found_or_adopted(logged, _find_header_steps, _adopt_header_steps)
    return {
        name: Mended(
            times.log_ns,
            None
            if times.stamp_ns is None
            else _without_steps(times.stamp_ns, header_steps[name], times.begins),
            (*log_steps[name], *header_steps[name]),
        )
        for name, times in logged.items()
    }


Steps = list[ClockStep]


def _found_or_adopted(
    streams: Mapping[str, Times],
    find: Callable[[Array, Array | None], Steps],
    adopt: Callable[[Times, Sequence[ClockStep]], Steps],
) -> dict[str, Steps]:
    """The steps of each stream, and in streams that show none those of others that fit."""
    found = _with_common_sizes(
        {name: _find_by_topic(times, find) for name, times in streams.items()}
    )
    common = _distinct_steps(found)
    return {name: steps or adopt(streams[name], common) for name, steps in found.items()}


def _find_by_topic(times: Times, find: Callable[[Array, Array | None], Steps]) -> Steps:
    """The steps in each topic of a stream, with rows of the stream."""
    found = Steps()
    for begin, end in pairwise((0, *times.begins, len(times.log_ns))):
        stamps = None if times.stamp_ns is None else times.stamp_ns[begin:end]
        found += [
            step._replace(row=begin + step.row) for step in find(times.log_ns[begin:end], stamps)
        ]
    return found


def _find_log_steps(log_ns: Array, stamp_ns: Array | None) -> Steps:
    """Falls of log times (n,) ns in the file after which the same times come again.

    Their size is the usual interval less the one at the fall, or what stamps that went on say.
    """
    intervals = np.diff(log_ns)
    falls = (1 + np.flatnonzero(intervals < 0)).tolist()
    if not 0 < len(falls) <= MOST_FALLS or 4 * len(falls) > len(intervals):
        return []
    steps = Steps()
    for begin, row, end in zip([0, *falls[:-1]], falls, [*falls[1:], len(log_ns)], strict=True):
        near = np.append(
            intervals[max(begin, row - LASTING) : row - 1],
            intervals[row : min(end, row + LASTING) - 1],
        )
        if not len(near):
            continue
        usual = median_by_sorting(near)
        size = usual - float(intervals[row - 1])
        std = 1.5 * median_by_sorting(np.abs(near - usual))
        regular_ns = np.rint(usual * np.arange(len(log_ns))).astype(np.int64)
        level, _ = _level_change(regular_ns - log_ns, begin, row, end, LASTING)
        lasts = abs(level - size) <= STEADY_SHARE * size
        if stamp_ns is not None and 0 < stamp_ns[row] - stamp_ns[row - 1] < 0.5 * size:
            size, std = _level_change(stamp_ns - log_ns, begin, row, end)
        if lasts and LEAST_STEP_NS < size < MOST_STEP_NS and _comes_again(log_ns, row, end):
            steps.append(ClockStep("log", row, int(log_ns[row - 1]), round(size), max(std, 1.0)))
    return steps


def _comes_again(log_ns: Array, row: int, end: int) -> bool:
    """Whether times (n,) ns from `row` on lie between earlier ones; a part written late is alone in
    its time.
    """
    after = log_ns[row:end]
    repeated = after[after < log_ns[row - 1]][:LASTING]
    if not len(repeated):
        return False
    last = log_ns[row - 1] if len(repeated) < FEWEST else repeated[-1]
    earlier = log_ns[:row]
    between = np.count_nonzero((earlier > repeated[0]) & (earlier <= last))
    return bool(between >= 0.5 * (len(repeated) - 1) and between)


def _adopt_log_steps(times: Times, common: Sequence[ClockStep]) -> Steps:
    """Steps of the recorder's clock in a stream too irregular, or with too few messages, to show
    them alone.

    Where its log times do not fall, the step shortened the shortest interval ending in the time
    that comes twice.
    """
    steps = Steps()
    log_ns = times.log_ns
    intervals = np.diff(log_ns)
    for step in common if not times.begins else ():
        near = np.abs(log_ns[:-1] - step.at_ns) <= SAME_STEP_NS
        falls = 1 + np.flatnonzero(near & (-intervals > 0.5 * step.by_ns))
        if len(falls):
            steps.append(step._replace(row=int(falls[0])))
            continue
        low, high = np.searchsorted(
            log_ns, (step.at_ns - step.by_ns, step.at_ns), side="right"
        ).tolist()
        if low < high <= low + FEWEST and low and high < len(log_ns):
            row = low + int(np.argmin(np.diff(log_ns[low - 1 : high + 1])))
            steps.append(step._replace(row=row))
        elif low == high < len(log_ns):
            steps.append(step._replace(row=low))
    return steps


def _find_header_steps(log_ns: Array, stamp_ns: Array | None) -> Steps:
    """Falls of stamps (n,) ns while log times (n,) ns go on, the returns from them, and leaps into
    the future.
    """
    if stamp_ns is None:
        return []
    late = log_ns - stamp_ns
    rows = _list_leaps(stamp_ns, late, LEAST_STEP_NS)
    if len(rows) > 2 * MOST_FALLS:
        # messages of uneven delay: only steps well beyond it are certain
        rows = _list_leaps(stamp_ns, late, 5 * LEAST_STEP_NS)
    if not 0 < len(rows) <= 2 * MOST_FALLS:
        return []
    steps = Steps()
    behind = 0
    for row, end in zip(rows, [*rows[1:], len(late)], strict=True):
        size, std = _level_change(late, steps[-1].row if steps else 0, row, end)
        set_forward = behind > 0 or _is_into_future(late, row, size)
        # delays that vary make a row before the step a candidate too, whose own change is small
        is_here = float(late[row] - late[row - 1]) / size > 0.5 if size else False
        is_step = LEAST_STEP_NS < abs(size) < MOST_STEP_NS and is_here
        if is_step and (size > 0 or set_forward):
            steps.append(ClockStep("header", row, int(log_ns[row - 1]), round(size), std))
            behind += round(size)
    return steps


def _list_leaps(stamp_ns: Array, late: Array, least_ns: int) -> list[int]:
    """Rows at which stamps (n,) ns fall or leap, and `late` (n,) ns changes by more than
    `least_ns`.
    """
    change = np.diff(late)
    interval = np.diff(stamp_ns)
    falls = (interval < 0) & (change > least_ns)
    leaps = (interval > least_ns) & (change < -least_ns)
    return (1 + np.flatnonzero(falls | leaps)).tolist()


def _is_into_future(late: Array, row: int, size: float) -> bool:
    """Whether stamps, `late` (n,) ns behind log times, agree with these up to `row`, and lead
    afterwards.
    """
    before = median_by_sorting(late[max(0, row - WINDOW) : row].astype(float))
    return size < 0.0 and abs(before) <= STEADY_SHARE * abs(size)


def _adopt_header_steps(times: Times, common: Sequence[ClockStep]) -> Steps:
    """Steps of other streams' clocks that this one's stamps follow, in a stream with so few that
    they do not fall.
    """
    steps = Steps()
    if times.stamp_ns is None or times.begins:
        return steps
    late = times.log_ns - times.stamp_ns
    for step in common:
        row = int(np.count_nonzero(times.log_ns <= step.at_ns))
        size, _ = _level_change(late, steps[-1].row if steps else 0, row, len(late))
        if size and abs(size - step.by_ns) <= STEADY_SHARE * abs(step.by_ns):
            steps.append(step._replace(row=row))
    return steps


def _level_change(
    late: Array, begin: int, row: int, end: int, window: int = WINDOW
) -> tuple[float, float]:
    """Change of the median of late (n,) ns at `row` and its std, from [begin, row) and what
    follows; 0 if not steady.

    What follows is [row, end), and more of it where that
    is short: a few messages out of order are no step.
    """
    last = max(min(end, row + window), min(len(late), row + LASTING))
    if min(row - begin, last - row) < FEWEST:
        return 0.0, 0.0
    # relative to one of them: float64 would round differences of fifty years to 256 ns
    before = (late[max(begin, row - window) : row] - late[row]).astype(float)
    after = (late[row:last] - late[row]).astype(float)
    size = median_by_sorting(after) - median_by_sorting(before)
    before_scatter, after_scatter = (
        1.5 * median_by_sorting(np.abs(side - median_by_sorting(side))) for side in (before, after)
    )
    if max(before_scatter, after_scatter) > STEADY_SHARE * abs(size):
        return 0.0, 0.0
    # the standard error of a median is 1.25 times that of a mean
    std = 1.25 * float(
        np.hypot(before_scatter / len(before) ** 0.5, after_scatter / len(after) ** 0.5)
    )
    return size, max(std, 1.0)


def _with_common_sizes(found: Mapping[str, Steps]) -> dict[str, Steps]:
    """Steps that may be one step of one clock, all with the size that is known best."""
    every = [step for steps in found.values() for step in steps]

    def with_common_size(step: ClockStep) -> ClockStep:
        best = min(
            (one for one in every if _may_be_one_step(one, step)), key=lambda one: one.std_ns
        )
        return step._replace(by_ns=best.by_ns, std_ns=best.std_ns)

    return {name: [with_common_size(step) for step in steps] for name, steps in found.items()}


def _may_be_one_step(one: ClockStep, other: ClockStep) -> bool:
    """Whether two steps may be one."""
    apart = abs(one.by_ns - other.by_ns)
    same_size = apart <= SAME_SIZE_NS + 5.0 * float(np.hypot(one.std_ns, other.std_ns))
    return same_size and abs(one.at_ns - other.at_ns) <= SAME_STEP_NS


def _distinct_steps(found: Mapping[str, Steps]) -> Steps:
    """Each step that any stream shows once, in order, as the stream that saw it latest dates it."""
    distinct = Steps()
    for step in sorted(
        (step for steps in found.values() for step in steps), key=lambda step: step.at_ns
    ):
        if distinct and _may_be_one_step(distinct[-1], step):
            distinct[-1] = step
        else:
            distinct.append(step)
    return distinct


def _without_steps(t_ns: Array, steps: Sequence[ClockStep], begins: Sequence[int]) -> Array:
    """Times (n,) ns of a stream on the clock before the steps; the first after a step is after the
    last before it.
    """
    mended = t_ns.copy() if steps else t_ns
    for step in steps:
        end = next((begin for begin in begins if begin > step.row), len(mended))
        least = (
            mended[step.row - 1] + 1 - mended[step.row]
            if step.row and step.by_ns > 0
            else step.by_ns
        )
        mended[step.row : end] += max(step.by_ns, int(least))
    return mended
