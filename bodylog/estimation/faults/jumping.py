"""Jumping encoders, found in their own readings: the level shifts faster than a joint can move.

Joints that stick and slip shift as fast. Images tell them apart: they show slips, and no jumps.
"""

from collections.abc import Sequence
from math import log, tau

import numpy as np

from ...types import Array
from ..inference.tangents import OFFSET_STD
from ..measurements.long_arrays import (
    LEVEL_READINGS,
    find_finite_rows,
    index_true_rows,
    measure_median_step,
)
from ..measurements.records import Encoders, Sighting
from ..measurements.timeline import GAP_STEPS
from ..noise.quantisation import find_reading_step, index_moves
from .threshold import EVIDENCE_THRESHOLD_NATS

MAX_ACCELERATION_RAD_S2 = 1000.0
"""rad/s²: largest acceleration of a joint; the fastest
parallel robots reach a third of it at 1 m (15 g at 0.5 m).
"""


MOST_STEPS_TO_SHIFT = 3.0
"""Usual steps between two readings beyond which the joint may have moved from one to the other."""
SIZE_READINGS = 2 * LEVEL_READINGS
"""Readings on each side of a jump that tell its size. On 1,800 jumps of drawn arms at 50 to 500 Hz
sizes are off by 0.90 to 0.95 of the stated standard deviation, and by 3.0 of it at most; with up to
40 readings, by up to 1.14 and 3.3."""
EVIDENT_SIGMAS = 8.0
"""Standard deviations of a reading's noise beyond which two readings show a slip."""
EVIDENT_COUNTS = 4.0
"""Counts beyond which they do: a slow joint turns by one count at a time, and stands in between."""
EVIDENT_SHARE = 0.3
"""Share of a joint's way that such slips make. In 72 drawn logs of smooth motion each joint has at
most 0.02. Of 72 logs of arms that stick by 9 mrad, 52 have a joint of 0.68 and more, and 20 have
none beyond 0.18, nearly all of them read at 25 Hz, where slips follow one another.
"""
SURE_SLIPS = 5
"""Such slips of one joint that show without images that it sticks: a jump or two is a fault of an
encoder."""


def find_evident_slips(t: Array, y: Array) -> Array:
    """Sizes (S,) rad of the slips of a joint that evidently sticks, from readings y (N,) rad at
    t (N,) s; none of other joints. It moves by steps between two readings alone, far beyond their
    noise and their count, and by less than half of a step before it and after it.
    """
    known = np.isfinite(y)
    y = y[known]
    least = _find_least_slip(y)
    if len(y) < 3 or least == 0.0:
        return np.zeros(0)
    steps = np.abs(np.diff(y))
    steps[np.diff(t[known]) > GAP_STEPS * measure_median_step(t)] = 0.0
    beside = np.maximum(np.append(0.0, steps[:-1]), np.append(steps[1:], 0.0))
    alone = (steps > least) & (beside < 0.5 * steps)
    # the first readings and the last may be false
    k = np.arange(len(steps))
    slips = steps[alone & (np.minimum(k, k[::-1]) >= LEVEL_READINGS - 1)]
    if len(slips):
        way = float(np.abs(np.diff(y[index_moves(y / least)])).sum())
        if slips.sum() > EVIDENT_SHARE * way:
            return np.asarray(slips)
    return np.zeros(0)


def _find_least_slip(y: Array) -> float:
    """The least step (rad) of readings y (N,) that shows a slip; 0 of readings without noise."""
    return max(EVIDENT_SIGMAS * estimate_reading_noise(y), EVIDENT_COUNTS * find_reading_step(y))


def average_between_slips(t: Array, y: Array) -> Array:
    """Readings y (N,) at t (N,) s of a joint that evidently sticks, or never moves, averaged
    while it stands still; those of others as they are.
    """
    known = np.flatnonzero(np.isfinite(y))
    least = _find_least_slip(y[known])
    moves_at_all = len(known) > 0 and np.ptp(y[known]) > least
    if moves_at_all and not len(find_evident_slips(t, y)):
        return y
    found = y.copy()
    moves = np.abs(np.diff(y[known])) > least
    begins = np.flatnonzero(np.append(True, moves))
    counts = np.diff(begins, append=len(known))
    found[known] = np.repeat(np.add.reduceat(y[known], begins) / counts, counts)
    return found


IMAGES_BESIDE_SHIFT = 3
"""Images whose medians show whether a joint slipped, before a shift and after it, or whether an
encoder jumped in a gap: one of three may be of something else."""
MOST_NATS_OF_IMAGE = 5.0
"""Nats that an image on either side tells of a shift at most: a single one of something else is
less than EVIDENCE_THRESHOLD_NATS."""


def measure_slip_nats(
    encoders: Encoders, images: Sequence[Sighting], joint: int, shifts: Sequence[tuple[int, float]]
) -> float:
    """Nats by which images take shifts in a joint's readings for slips of the joint: from before
    each shift to after it they move as the readings say.

    shifts: first index after each, and its size, in the readings' unit.
    """
    return sum(_measure_slip_nats_of_view(encoders, one, joint, shifts) for one in images)


def _measure_slip_nats_of_view(
    encoders: Encoders, sighting: Sighting, joint: int, shifts: Sequence[tuple[int, float]]
) -> float:
    """The same of one sense's images."""
    own = np.arange(encoders.values.shape[1]) == joint
    rows = np.flatnonzero(find_finite_rows(sighting.values))
    t = sighting.t[rows]
    x = encoders.interpolate_at(t)
    mean, slope, var = sighting.model.predict(x)
    off = sighting.values[rows] - mean
    scatter = [estimate_reading_noise(y[np.isfinite(y)]) for y in encoders.values.T]
    noise = sighting.var[rows] + var + np.square(slope) @ np.square(scatter)
    seen = _join_unseen_shifts(t, encoders.t, shifts)
    firsts = [0, *(first for _, first, _ in seen)]
    ends = [*(end for end, _, _ in seen), len(t)]
    nats = 0.0
    for k, (_, _, size) in enumerate(seen):
        before = slice(max(firsts[k], ends[k] - IMAGES_BESIDE_SHIFT), ends[k])
        after = slice(firsts[k + 1], min(ends[k + 1], firsts[k + 1] + IMAGES_BESIDE_SHIFT))
        count = min(before.stop - before.start, after.stop - after.start)
        if count < 1:
            continue
        unshifted = sighting.model.predict(x[after] - size * own)[0] - mean[after]
        left = np.median(off[after], axis=0) - np.median(off[before], axis=0)
        # that of single images: a median of three has about half of it
        both = np.mean(noise[before], axis=0) + np.mean(noise[after], axis=0)
        slipped = 0.5 * float((np.square(left) / both).sum())
        jumped = 0.5 * float((np.square(left - np.median(unshifted, axis=0)) / both).sum())
        most = MOST_NATS_OF_IMAGE * count
        explained = slipped < EVIDENCE_THRESHOLD_NATS
        nats += float(np.clip(jumped - slipped, -most, most)) if explained else -most
    return nats


def _join_unseen_shifts(
    images: Array, readings: Array, shifts: Sequence[tuple[int, float]]
) -> list[tuple[int, int, float]]:
    """Shifts of readings at (N,) s as images at (F,) s show them, those without an image in between
    as one: how many images there are before it, the first image after it, and its size.
    """
    joined = list[tuple[int, int, float]]()
    for at, size in shifts:
        # an image between two readings may show either
        end = int(np.searchsorted(images, readings[at - 1], "right"))
        first = int(np.searchsorted(images, readings[at]))
        if joined and end <= joined[-1][1]:
            end, _, before = joined.pop()
            size += before
        joined.append((end, first, size))
    return joined


def find_jumps(t: Array, y: Array) -> list[tuple[int, float, float]]:
    """Return first index after each lasting shift in level
    of y (N,) rad at t (N,) s, its size and std (rad).
    """
    known = np.flatnonzero(np.isfinite(y))
    when = t[known]
    v = y[known]
    begins = [at for at, _, nats in find_level_shifts(t, y) if nats > EVIDENCE_THRESHOLD_NATS]
    at_known = np.searchsorted(known, begins)
    edges = [0, *at_known.tolist(), len(known)]
    return [
        (at, *_fit_jump_size(when[before:after], v[before:after], middle - before))
        for at, before, middle, after in zip(begins, edges, edges[1:], edges[2:], strict=False)
    ]


def _fit_jump_size(t: Array, v: Array, at: int) -> tuple[float, float]:
    """Size and std (rad) of a jump before the reading
    `at` of v (N,) rad at t (N,) s: a cubic and a step.
    """
    window = slice(max(0, at - SIZE_READINGS), at + SIZE_READINGS)
    since = t[window] - t[at]
    after = np.where(since >= 0.0, 1.0, 0.0)
    basis = np.column_stack([np.vander(since / np.abs(since).max(), 4), after])
    fitted = np.linalg.lstsq(basis, v[window] - v[at])[0]
    off = v[window] - v[at] - basis @ fitted
    freedom = max(len(off) - basis.shape[1], 1)
    scatter = max(estimate_reading_noise(v), float(np.sqrt(off @ off / freedom)))
    std = scatter * float(np.linalg.norm(np.linalg.pinv(basis)[-1]))
    return float(fitted[-1]), std


def estimate_reading_noise(v: Array) -> float:
    """Scatter (rad) of readings v (N,), by second differences, and at least that of rounding."""
    bends = np.abs(np.diff(v, 2))
    # a normal scatter σ has second differences of √6 σ, whose median size is 0.67 of that
    scatter = float(np.median(bends)) / (0.6745 * 6.0**0.5) if len(bends) else 0.0
    rounding = find_reading_step(v) / 12.0**0.5
    return float(max(scatter, rounding))


def index_resumed_readings(t: Array, y: Array) -> Array:
    """The first of readings y (N,) at t (N,) s, and those after gaps."""
    known = np.flatnonzero(np.isfinite(y))
    steps = np.diff(t[known])
    gaps = steps >= MOST_STEPS_TO_SHIFT * measure_median_step(t[known])
    return np.asarray(known[np.append(True, gaps)])


def find_level_shifts(t: Array, y: Array) -> list[tuple[int, float, float]]:
    """The first index after each shift that may be a jump, its
    size (rad) and the nats it wins, for y (N,) at t (N,) s.

    The largest sound shift wins EVIDENCE_THRESHOLD_NATS.
    The largest step is among them, sound or not.
    """
    known = index_true_rows(np.isfinite(y))
    v = y[known]
    when = t[known]
    if len(v) < 4 * LEVEL_READINGS:
        return []
    steps = np.diff(v)
    usual = measure_median_step(when)
    bound = _find_largest_sound_step(steps, when, usual)
    # after a gap the joint may have moved to the new reading
    resumed = index_resumed_readings(when, v)
    sizes = np.abs(steps)
    sizes[resumed[1:] - 1] = 0.0
    tried = {*np.flatnonzero(sizes > bound).tolist(), int(sizes.argmax())}
    firsts = resumed[np.searchsorted(resumed, sorted(tried), "right") - 1]
    found = [
        (k, _measure_level_shift(v, k, first))
        for k, first in zip(sorted(tried), firsts.tolist(), strict=True)
    ]
    return [
        (int(np.searchsorted(t, when[k + 1])), size, EVIDENCE_THRESHOLD_NATS * (size / bound) ** 2)
        for k, size in found
    ]


def _find_largest_sound_step(steps: Array, when: Array, usual: float) -> float:
    """Largest step (rad) of a sound encoder, from
    steps (N-1,) rad at `when` (N,) s, `usual` s apart.
    """
    # from rest to rest in a time h takes 4 s/h²
    fastest = MAX_ACCELERATION_RAD_S2 * max(usual, _measure_hold_time(steps, when)) ** 2 / 4.0
    return max(EVIDENCE_THRESHOLD_NATS * _estimate_step_scale(steps), OFFSET_STD, fastest)


def _measure_level_shift(v: Array, k: int, first: int) -> float:
    """Shift in level (rad) of readings v (N,) after the
    k-th; 0 if they change as much beside it, or too few follow.

    `first`: the reading after the last gap. Fewer may be false there than show a level: no belief
    comes before them, by which they could be rejected.
    """
    before = v[max(first, k + 1 - LEVEL_READINGS) : k + 1]
    after = v[k + 1 : k + 1 + LEVEL_READINGS]
    if len(after) < LEVEL_READINGS:
        return 0.0
    size = _extrapolate_level(after[::-1]) - _extrapolate_level(before)
    beside = np.abs(np.append(np.diff(before), np.diff(after)))
    return size if float(beside.max()) < abs(size) / 2 else 0.0


def unwrap_turns(y: Array) -> Array:
    """Readings y (N,) rad, NaN where missing, with whole turns between neighbours removed."""
    # a shift nearer to half a turn is a false reading
    found = y.copy()
    known = np.isfinite(y)
    found[known] = np.unwrap(y[known], 0.75 * tau)
    return found


def _measure_hold_time(steps: Array, t: Array) -> float:
    """Time (s), at most 0.1, for which the driver holds
    a reading, from steps (N-1,) rad at t (N,) s, or 0.
    """
    sizes = np.abs(steps)
    if 2 * np.count_nonzero(steps) > len(steps):
        return 0.0
    moved = np.flatnonzero(sizes > 1.5 * sizes[sizes > 0.0].min(initial=np.inf))
    return min(float(np.quantile(np.diff(t[moved]), 0.1)), 0.1) if len(moved) > 3 else 0.0


def _estimate_step_scale(steps: Array) -> float:
    """Scale (rad) of steps (N,) rad with the long tails of motion, e^(−|step|/scale): a step of
    EVIDENCE_THRESHOLD_NATS scales wins EVIDENCE_THRESHOLD_NATS.

    For coarse encoders, whose median step is 0, the median nonzero step.
    """
    if half := float(np.median(np.abs(steps - np.median(steps)))):
        return half / log(2.0)
    moved = np.abs(steps[steps != 0.0])
    return float(np.median(moved)) if len(moved) else 0.0


def _extrapolate_level(v: Array) -> float:
    """Level of a short piece at its last reading, by a straight line; of one or two, that one."""
    if len(v) < 3:
        return float(v[-1])
    return float(np.polyfit(np.arange(1 - len(v), 1), v, 1)[1])
