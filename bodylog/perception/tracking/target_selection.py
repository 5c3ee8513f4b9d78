"""Select the target's blob: blobs are linked to
runs through time, runs compared by size and motion.
"""

from dataclasses import dataclass, field
from functools import cached_property
from math import hypot
from typing import NamedTuple

import numpy as np

from ...types import Array
from ..colours.blob_measurement import BORDER, MASS, STD_U, STD_V, STRENGTH, U, V

_PATIENCE = 0.5
_REACH = 0.08
_RESIZED = 2.5
_LARGER = 1.6
_SMALL = 0.4
_STILL = 3.0
_MOVING = 12.0
_EVIDENCE = 5
_DEFICIT = 0.12
_CHANGE = 0.05
_NEAR = 0.5
_AT_ONCE = 1024
HIDDEN = "hidden"
EDGE = "at the border"
RIVAL = "two candidates"
SIZE = "wrong size"
JUMP = "too far away"
PARTLY = "partly hidden"
FOREIGN = "not where the joints put it"
_FAR_MORE = 3.0


@dataclass
class _BlobRun:
    """One blob followed through time: frame indices and its rows of fields."""

    frames: list[int] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)

    @cached_property
    def table(self) -> Array:
        return np.array(self.rows)

    @cached_property
    def index(self) -> Array:
        return np.array(self.frames)

    @cached_property
    def strength(self) -> float:
        return float(np.median(self.table[:, STRENGTH]))

    @cached_property
    def extent(self) -> float:
        """The extent (px): the larger of the central 80 % ranges in u and v."""
        low, high = np.quantile(self.table[:, [U, V]], (0.1, 0.9), axis=0)
        return float((high - low).max())


def select_target(t: Array, found: Array, width: float) -> tuple[Array, Array]:
    """u, v, std_u, std_v (N,4) px of the target among found
    (N,candidates,FIELDS), NaN where unsure; why (N,) str.
    """
    track = np.full((len(t), 4), np.nan)
    why = np.full(len(t), HIDDEN, dtype=object)
    runs = _link_into_runs(t, found, _REACH * width)
    if not runs:
        return track, why
    runs = _runs_of_right_size(_undominated_runs(runs, why), why)
    runs = _reachable_runs(t, runs, _REACH * width, why)
    mass = np.full(len(t), np.nan)
    for run in runs:
        rows = run.table
        clear = (rows[:, BORDER] == 0) & (why[run.frames] != RIVAL)
        why[run.index[rows[:, BORDER] == 1]] = EDGE
        track[run.index[clear]] = rows[clear][:, [U, V, STD_U, STD_V]]
        mass[run.index[clear]] = rows[clear][:, MASS]
    track[:, 2:] = smooth_std(t, track[:, 2:])
    _drop_partly_hidden(t, track, mass, why)
    return track, why


def link_blobs(t: Array, found: Array, width: float) -> list[tuple[Array, Array]]:
    """Blobs found (N,candidates,FIELDS) joined through
    time: of each run its frames (n,) and rows (n,FIELDS).
    """
    return [(run.index, run.table) for run in _link_into_runs(t, found, _REACH * width)]


def _link_into_runs(t: Array, found: Array, reach: float) -> list[_BlobRun]:
    """Blobs joined to the nearest open run that is
    close enough and of like size; others open a run.
    """
    open_runs: list[_BlobRun] = []
    closed: list[_BlobRun] = []
    seen = np.isfinite(found[:, :, U])
    some = np.flatnonzero(seen[:, 0])
    times = t[some].tolist()
    frames = some.tolist()
    ends = _last_single_frames(t[some], found[some], reach)
    at = 0
    while at < len(frames):
        index = frames[at]
        closed += [run for run in open_runs if times[at] - t[run.frames[-1]] > _PATIENCE]
        open_runs = [run for run in open_runs if times[at] - t[run.frames[-1]] <= _PATIENCE]
        taken: set[int] = set()
        for row in found[index, seen[index]].tolist():
            run = _nearest_open_run(open_runs, taken, row, reach)
            if run is None:
                run = _BlobRun()
                open_runs.append(run)
            taken.add(id(run))
            run.frames.append(index)
            run.rows.append(row)
        end = ends[at]
        at += 1
        if len(open_runs) == 1 and at < end:
            # nothing else that any of these frames could belong to
            open_runs[0].frames += frames[at:end]
            open_runs[0].rows += found[some[at:end], 0].tolist()
            at = end
    return sorted(closed + open_runs, key=lambda run: run.frames[0])


def _last_single_frames(t: Array, found: Array, reach: float) -> list[int]:
    """For each frame (n,), up to which one each shows a
    single blob that goes on where the one before was.
    """
    place = found[:, 0, [U, V]]
    mass = found[:, 0, MASS]
    border = found[:, 0, BORDER] == 1
    step = np.hypot(*np.diff(place, axis=0).T)
    grown = mass[1:] / mass[:-1]
    similar = border[1:] | border[:-1] | (grown > 1 / _RESIZED) & (grown < _RESIZED)
    single = np.isfinite(found[:, :, U]).sum(axis=1) == 1
    follows = single[1:] & single[:-1] & similar & (step <= reach) & (np.diff(t) <= _PATIENCE)
    breaks = np.append(np.flatnonzero(~follows) + 1, len(t))
    return list(breaks[np.searchsorted(breaks, np.arange(len(t)), side="right")].tolist())


def _nearest_open_run(
    runs: list[_BlobRun], taken: set[int], row: list[float], reach: float
) -> _BlobRun | None:
    best_run = None
    best_distance = reach
    for run in runs:
        last = run.rows[-1]
        distance = hypot(row[U] - last[U], row[V] - last[V])
        similar = row[BORDER] or last[BORDER] or 1 / _RESIZED < row[MASS] / last[MASS] < _RESIZED
        if distance <= best_distance and similar and id(run) not in taken:
            best_run = run
            best_distance = distance
    return best_run


def _undominated_runs(runs: list[_BlobRun], why: Array) -> list[_BlobRun]:
    """Runs that lose to no run they share frames with;
    where two tie, those frames are marked RIVAL.
    """
    beaten: set[int] = set()
    for first in range(len(runs)):
        for second in range(first + 1, len(runs)):
            if runs[second].frames[0] > runs[first].frames[-1]:
                break
            shared = _shared_frames(runs[first].index, runs[second].index)
            if not shared.size:
                continue
            winner = _stronger_run(runs[first], runs[second])
            if winner is None:
                why[shared] = RIVAL
            else:
                beaten.add(second if winner == 0 else first)
    return [run for index, run in enumerate(runs) if index not in beaten]


def _shared_frames(first: Array, second: Array) -> Array:
    """The frames of two runs' frames in order that both have: the shorter's, looked up."""
    short, long = sorted((first, second), key=len)
    at = np.minimum(np.searchsorted(long, short), len(long) - 1)
    return np.asarray(short[long[at] == short])


def _stronger_run(first: _BlobRun, second: _BlobRun) -> int | None:
    """0 or 1 for the stronger run, or else for the moving
    one beside a still one; None when neither is clear.
    """
    ratio = first.strength / second.strength
    if ratio >= _LARGER or ratio <= 1 / _LARGER:
        return 0 if ratio > 1 else 1
    extents = [first.extent, second.extent]
    if min(extents) < _STILL and max(extents) > _MOVING:
        return int(np.argmax(extents))
    return None


def _runs_of_right_size(runs: list[_BlobRun], why: Array) -> list[_BlobRun]:
    """Runs not much weaker than the longest one."""
    usual = max(runs, key=lambda run: len(run.frames)).strength
    kept = []
    for run in runs:
        if run.strength >= _SMALL * usual or run.table[:, BORDER].any():
            kept.append(run)
        else:
            why[run.frames] = SIZE
    return kept


def _reachable_runs(t: Array, runs: list[_BlobRun], reach: float, why: Array) -> list[_BlobRun]:
    """Drop still runs of a moving log that the target cannot reach at its speed."""
    speed = 2.0 * max(_fastest_speed(t, run) for run in runs)
    moving = max(run.extent for run in runs) > _MOVING
    ordered = sorted(runs, key=lambda run: -len(run.frames))
    ends = _ends_of_runs(t, ordered)
    kept = np.zeros(len(ordered), bool)
    for number, run in enumerate(ordered):
        still = moving and len(run.frames) >= _EVIDENCE and run.extent < _STILL
        kept[number] = not still or bool(_runs_within_reach(ends, number, reach, speed)[kept].all())
        if not kept[number]:
            why[run.frames] = JUMP
    return [run for run, stays in zip(ordered, kept.tolist(), strict=True) if stays]


class _Ends(NamedTuple):
    """Of each run the first and last time (R,) s, and the places (R,2) px there."""

    start: Array
    end: Array
    first: Array
    last: Array


def _ends_of_runs(t: Array, runs: list[_BlobRun]) -> _Ends:
    start = t[[run.frames[0] for run in runs]]
    end = t[[run.frames[-1] for run in runs]]
    first = [run.table[0, [U, V]] for run in runs]
    last = [run.table[-1, [U, V]] for run in runs]
    return _Ends(start, end, np.array(first), np.array(last))


def _runs_within_reach(ends: _Ends, number: int, reach: float, speed: float) -> Array:
    """Whether the target gets from one run to each other (R,), or back, at that speed (px/s)."""
    sooner = ends.start[number] < ends.start
    gap = np.where(sooner, ends.start - ends.end[number], ends.start[number] - ends.end)
    there = ends.first - ends.last[number]
    back = ends.first[number] - ends.last
    step = np.where(sooner[:, None], there, back)
    return np.asarray((gap < 0) | (np.hypot(*step.T) <= reach + speed * gap))


def _fastest_speed(t: Array, run: _BlobRun) -> float:
    """The 95th percentile of a run's speed, px/s."""
    if len(run.frames) < 3:
        return 0.0
    step = np.diff(run.table[:, [U, V]], axis=0)
    return float(
        np.quantile(
            np.hypot(step[:, 0], step[:, 1]) / np.maximum(np.diff(t[run.frames]), 1e-3), 0.95
        )
    )


def _drop_partly_hidden(t: Array, track: Array, mass: Array, why: Array) -> None:
    """Rows where area is missing against the views around
    them go; a little missing area widens their std.
    """
    seen = np.flatnonzero(np.isfinite(mass))
    if not seen.size:
        return
    usual, spread = _expected_area(t[seen], mass[seen])
    missing = 1 - mass[seen] / usual
    most = max(_DEFICIT, 5 * spread)
    bad = np.union1d(seen[missing > most], _indices_of_vanishing(mass, most))
    track[bad] = np.nan
    why[bad] = PARTLY
    # a disc of radius r that lost a share f of its area has its centre off by about f r
    shift = np.maximum(missing - max(_CHANGE, 4 * spread), 0) * np.sqrt(usual / np.pi)
    track[seen, 2:] = np.hypot(track[seen, 2:], shift[:, None])


def _indices_of_vanishing(mass: Array, most: float) -> Array:
    """Indices beside unseen frames whose area is a share
    `most` below that of the two seen frames next to them.
    """
    mass = mass.copy()
    found = []
    for _ in range(3):
        padded = np.pad(mass, 2, constant_values=np.nan)
        forward = 2 * padded[1:-3] - padded[:-4]
        backward = 2 * padded[3:-1] - padded[4:]
        last = np.isnan(padded[3:-1]) & (forward > 0)
        first = np.isnan(padded[1:-3]) & (backward > 0)
        short = (last & (mass < (1 - most) * forward)) | (first & (mass < (1 - most) * backward))
        found.append(np.flatnonzero(short))
        mass[short] = np.nan
    return np.concatenate(found)


def _expected_area(t: Array, mass: Array) -> tuple[Array, float]:
    """The area expected at each time from lines through the
    whole views around it, and the share it scatters by.
    """
    whole = np.ones(len(t))
    expected = mass
    spread = 0.0
    for _ in range(3):
        expected = _values_on_local_lines(t, mass, whole)
        missing = 1 - mass / expected
        spread = 1.4826 * float(np.median(np.abs(missing)))
        whole = (missing < max(_CHANGE, 3 * spread)).astype(float)
    return expected, spread


def _values_on_local_lines(t: Array, values: Array, weight: Array) -> Array:
    """At each time, the weighted line through the values
    within _NEAR s: (N,); the value itself if none count.

    Running sums restart every _AT_ONCE rows, with times and values from there on: those of a whole
    log are so large that what one window adds drowns in their rounding.
    """
    low = np.searchsorted(t, t - _NEAR)
    high = np.searchsorted(t, t + _NEAR, side="right")
    expected = np.empty(len(t))
    for first in range(0, len(t), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        near = slice(int(low[some][0]), int(high[some][-1]))
        windows = low[some] - near.start, high[some] - near.start
        origin = t[first], values[first]
        lines = _line_fits_of_windows(
            t[near] - origin[0], values[near] - origin[1], weight[near], *windows
        )
        n, middle, mean, slope = lines
        line = origin[1] + mean + slope * (t[some] - origin[0] - middle)
        expected[some] = np.where(n > 0.5, np.maximum(line, 1.0), values[some])
    return expected


def _line_fits_of_windows(
    t: Array, values: Array, weight: Array, low: Array, high: Array
) -> tuple[Array, Array, Array, Array]:
    """Weight, mean time, mean value and slope of the
    rows low to high (K,) of each window: (K,) each.
    """
    columns = weight[:, None] * np.column_stack([np.ones_like(t), t, t * t, values, t * values])
    running = np.vstack([np.zeros(5), np.cumsum(columns, axis=0)])
    n, s, ss, v, sv = (running[high] - running[low]).T
    n = np.maximum(n, 1e-12)
    middle = s / n
    spread = ss - middle * s
    slope = np.where(spread > 1e-6, (sv - middle * v) / np.maximum(spread, 1e-6), 0.0)
    return n, middle, v / n, slope


def smooth_std(t: Array, std: Array) -> Array:
    """The usual std (N,2) px within half a second, or a
    point's own where that is far larger; NaN rows stay NaN.

    The usual variance is the mean without values far above the median: outlines that differ from
    image to image average out, and those of a still target keep their one value.
    """
    seen = np.isfinite(std[:, 0])
    times = t[seen]
    own = std[seen]
    low = np.searchsorted(times, times - _NEAR)
    high = np.searchsorted(times, times + _NEAR, side="right")
    usual = np.sqrt(_windowed_means(own**2, low, high))
    steadied = np.full(std.shape, np.nan)
    steadied[seen] = np.where(own > _FAR_MORE * usual, own, usual)
    return steadied


def _windowed_means(values: Array, low: Array, high: Array) -> Array:
    """Means of values[low:high] up to _FAR_MORE² medians,
    by column: (N,2) of (N,2), a thousand rows at once.
    """
    count = high - low
    means = np.empty(values.shape[::-1])
    for start in range(0, len(values), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        places = low[some, None] + np.arange(count[some].max())
        inside = places < high[some, None]
        windows = np.where(inside, values.T[:, np.where(inside, places, 0)], np.inf)
        windows.sort(axis=2)
        middle = np.stack([(count[some] - 1) // 2, count[some] // 2], axis=1)
        most = _FAR_MORE**2 * np.take_along_axis(windows, middle[None], axis=2).mean(axis=2)
        usual = windows <= most[:, :, None]
        means[:, some] = np.where(usual, windows, 0).sum(axis=2) / usual.sum(axis=2)
    return means.T
