"""Contact strokes of the other's hand: where its path
slows down and turns between an approach and a retreat.

The path is cut into straight, even pieces by dynamic programming; a stroke is the slow stretch
between two faster ones, without the pieces in which the hand still comes the way of the approach,
or already leaves the way of the retreat. Its start and end are where neighbouring pieces meet,
which is finer than a frame.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...types import Array, Series, Stroke

_GAP = 0.35
_LEAP = 5.0
_LONGEST = 6.0
_FEWEST = 2
_SLOW = 0.8
_APPROACH = 3
_REACH = 0.12
_EVEN = 0.5
_STEP = 3.0
_SHORTEST = 0.15
_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class _PathPiece:
    """Even motion from start to end (s): at `place` (2,)
    px when t = middle, moving with `velocity` (2,) px/s.
    """

    start: float
    end: float
    middle: float
    place: Array
    velocity: Array

    @property
    def speed(self) -> float:
        return float(np.hypot(*self.velocity))

    def at(self, t: float) -> Array:
        return np.asarray(self.place + self.velocity * (t - self.middle))


def find_strokes(hand: Series) -> tuple[Stroke, ...]:
    """The contact strokes in a hand's track (N,2) px,
    in order; a stroke never spans a gap in the track.
    """
    seen = np.isfinite(hand.values).all(axis=1)
    t = hand.t[seen]
    place = hand.values[seen]
    found: list[Stroke] = []
    for part in _tracked_stretches(t, place):
        if len(t[part]) >= 3 * _FEWEST:
            reach = max(1.5 * float(np.median(np.diff(t[part]))), _REACH)
            for about in _contact_times(_fit_path_pieces(t[part], place[part])):
                found += _measure_stroke(t[part], place[part], about, reach)
    return tuple(found)


def _tracked_stretches(t: Array, place: Array) -> list[slice]:
    """The stretches in which the hand was tracked without a long gap or a jump."""
    step = np.hypot(*np.diff(place, axis=0).T) / np.maximum(np.diff(t), 1e-6)
    usual = float(np.quantile(step, 0.9)) if step.size else 0.0
    cuts = np.flatnonzero((np.diff(t) > _GAP) | (step > _LEAP * usual)) + 1
    edges = [0, *cuts.tolist(), len(t)]
    return [slice(a, b) for a, b in pairwise(edges)]


def _fit_path_pieces(t: Array, place: Array) -> list[_PathPiece]:
    """The path as the fewest straight, even pieces its noise allows."""
    edges = np.array(_choose_cuts(t, place))
    begins = edges[:-1]
    count = np.diff(edges)
    middle = np.add.reduceat(t, begins) / count
    where = np.add.reduceat(place, begins) / count[:, None]
    away = t - np.repeat(middle, count)
    along = np.add.reduceat(away[:, None] * (place - np.repeat(where, count, axis=0)), begins)
    velocity = along / np.add.reduceat(away * away, begins)[:, None]
    times = zip(t[begins].tolist(), t[edges[1:] - 1].tolist(), middle.tolist(), strict=True)
    return [_PathPiece(*each, w, v) for each, w, v in zip(times, where, velocity, strict=True)]


def _choose_cuts(t: Array, place: Array) -> list[int]:
    """Edges of the pieces (0 … n) that minimise squared error
    over noise plus a price per piece (Bayes' criterion).
    """
    count = len(t)
    longest = max(2 * _FEWEST, int(np.searchsorted(t - t[0], _LONGEST)))
    price = _path_noise_px(place) ** 2 * 5.0 * np.log(count)
    came = np.zeros(count + 1, dtype=int)
    # the cost up to each edge, padded with impossible edges for one longest piece
    cost = np.full(longest + count + 1, np.inf)
    cost[longest] = 0.0
    for end, errors in enumerate(_squared_errors_by_end(t, place, longest), _FEWEST):
        total = cost[end : end + len(errors)] + errors
        best = int(total.argmin())
        cost[longest + end] = total[best] + price
        came[end] = end - longest + best
    edges = [count]
    while edges[-1]:
        edges.append(int(came[edges[-1]]))
    return edges[::-1]


def _running_sums(t: Array, place: Array) -> Array:
    """Sums over the first k points of 1, t, t², u, v, tu, tv, u² + v²: (8, n + 1)."""
    u, v = place.T
    rows = np.stack([np.ones_like(t), t, t * t, u, v, t * u, t * v, u * u + v * v])
    return np.hstack([np.zeros((8, 1)), np.cumsum(rows, axis=1)])


def _squared_errors_by_end(t: Array, place: Array, longest: int) -> Iterator[Array]:
    """For each end from _FEWEST on, the squared errors of the
    lines from `longest` points before it to _FEWEST before.

    Those that would begin before the first point begin there. Sums run over the points of a few
    ends alone, counted from the middle one: sums since the start of a long track would drown the
    differences between them in rounding.
    """
    for first in range(_FEWEST, len(t) + 1, _AT_ONCE):
        end = min(first + _AT_ONCE, len(t) + 1)
        begin = max(0, first - longest)
        middle = (begin + end) // 2
        near = slice(begin, end - 1)
        sums = _running_sums(t[near] - t[middle], place[near] - place[middle])
        before = np.pad(sums, ((0, 0), (longest - (first - begin), 0)), mode="edge")
        begins = np.lib.stride_tricks.sliding_window_view(before, longest - _FEWEST + 1, axis=1)
        yield from _squared_error(sums[:, first - begin :, None] - begins[:, : end - first])


def _squared_error(sums: Array) -> Array:
    """Squared error (…) of the best line through each set of points given by its sums (8,…)."""
    n, s, ss, u, v, su, sv, square = sums
    spread = np.maximum(ss - s * s / n, 1e-12)
    along = (su - s * u / n) ** 2 + (sv - s * v / n) ** 2
    return np.asarray(np.maximum(square - (u * u + v * v) / n - along / spread, 0.0))


def _path_noise_px(place: Array) -> float:
    """Standard deviation (px) of one coordinate about a
    smooth path: third differences have 20 times its variance.
    """
    third = np.diff(place, n=3, axis=0)
    return max(0.1, 1.4826 * float(np.median(np.abs(third))) / np.sqrt(20.0)) if third.size else 0.1


def _contact_times(pieces: Sequence[_PathPiece]) -> list[tuple[float, float]]:
    """About when (s) the slow stretches between faster pieces begin and end."""
    speeds = [piece.speed for piece in pieces]
    found = []
    after = 0
    for index in range(1, len(pieces) - 1):
        if index > after and speeds[index - 1] >= speeds[index] < speeds[index + 1]:
            before, after = _peaks_beside_valley(speeds, index)
            fast = min(speeds[before], speeds[after])
            first, last = _pieces_below_limit(speeds, index, _SLOW * fast)
            if first <= last:
                steady = max(pieces[first : last + 1], key=lambda piece: piece.end - piece.start)
                limit = min(_SLOW * fast, (steady.speed * fast) ** 0.5)
                first, last = _pieces_below_limit(speeds, index, max(1.01 * speeds[index], limit))
                found.append(
                    (_time_between_pieces(pieces, first), _time_between_pieces(pieces, last + 1))
                )
    return found


def _peaks_beside_valley(speeds: Sequence[float], valley: int) -> tuple[int, int]:
    """The pieces of highest speed on either side of a valley."""
    before = valley
    after = before
    while before > 0 and speeds[before - 1] >= speeds[before]:
        before -= 1
    while after + 1 < len(speeds) and speeds[after + 1] >= speeds[after]:
        after += 1
    return before, after


def _pieces_below_limit(speeds: Sequence[float], valley: int, limit: float) -> tuple[int, int]:
    """First and last piece around a valley below a speed
    limit; last < first where the valley itself is above it.
    """
    if speeds[valley] >= limit:
        return valley, valley - 1
    first = valley
    last = first
    while speeds[first - 1] < limit:
        first -= 1
    while speeds[last + 1] < limit:
        last += 1
    return first, last


def _time_between_pieces(pieces: Sequence[_PathPiece], second: int) -> float:
    return 0.5 * (pieces[second - 1].end + pieces[second].start)


def _measure_stroke(
    t: Array, place: Array, about: tuple[float, float], reach: float
) -> list[Stroke]:
    """The stroke around these times, both ends found to less than a frame; empty if too short."""
    middle = 0.5 * (about[0] + about[1])
    start, start_px = _find_corner(t, place, about[0], middle, reach)
    end, end_px = _find_corner(-t[::-1], place[::-1], -about[1], -middle, reach)
    end = -end
    if end - start < _SHORTEST or float(np.hypot(*(end_px - start_px))) < _STEP:
        return []
    return [
        Stroke(
            start,
            end,
            (float(start_px[0]), float(start_px[1])),
            (float(end_px[0]), float(end_px[1])),
        )
    ]


def _find_corner(
    t: Array, place: Array, about: float, until: float, reach: float
) -> tuple[float, Array]:
    """When (s) and where (2,) px the path turns from accelerated
    motion to an even one, within `reach` of `about`.

    Least squares of a path that is continuous, of second
    order before the corner and of first order after it.
    """
    for width in (reach, reach, reach / 30):
        first, even = np.searchsorted(t, (about - reach, min(until, about + _EVEN))).tolist()
        near = slice(max(0, first - _APPROACH), max(int(np.searchsorted(t, about)) + 3, even))
        times = about + np.linspace(-width, width, 61)
        about = float(times[int(np.argmin(_errors_of_corners(t[near], place[near], times)))])
    return about, _place_of_corner(t[near], place[near], about)


def _errors_of_corners(t: Array, place: Array, corners: Array) -> Array:
    """Squared error (K,) of the best path with its corner at each of these times (K,)."""
    away = (t - corners[:, None]) / (t[-1] - t[0])
    before = np.minimum(away, 0.0)
    after = np.maximum(away, 0.0)
    curved = (np.searchsorted(t, corners) > _APPROACH)[:, None]
    each = np.full(len(t), 1.0 / len(t))
    directions: list[Array] = []
    for column in (before, after, curved * before**2):
        column -= (column @ each)[:, None]
        for other in directions:
            column -= np.einsum("kn,kn->k", column, other)[:, None] * other
        # a column of zeros, or a combination of the others, is no direction
        column /= np.sqrt(np.einsum("kn,kn->k", column, column) + 1e-12 * len(t))[:, None]
        directions.append(column)
    place = place - each @ place
    along = np.concatenate(directions) @ place
    return np.asarray((place**2).sum() - (along**2).sum(axis=1).reshape(3, -1).sum(axis=0))


def _place_of_corner(t: Array, place: Array, corner: float) -> Array:
    """The corner (2,) px of the best path with its corner at that time."""
    before = np.minimum(t - corner, 0.0)
    after = np.maximum(t - corner, 0.0)
    columns = [np.ones_like(t), before, after]
    if np.count_nonzero(before) > _APPROACH:
        columns.append(before**2)
    return np.asarray(np.linalg.lstsq(np.column_stack(columns), place, rcond=None)[0][0])
