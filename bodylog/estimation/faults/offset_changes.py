"""Offsets of one encoder as hypotheses of the whole filter: a random walk, a step, from which on
all readings are off by a constant, or a steady drift.

Time and size b of a step or drift are those of greatest evidence. A size that is N(0, P²) a priori,
P being PRIOR_STD_RAD, with standard error σ, and a time at any of N readings after the start, cost
½ ln(1 + P²/σ²) + ½ b²/P² + ln N nats of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import comb
from typing import NamedTuple

import numpy as np

from ...types import Array, Fault, FaultKind
from ..inference.filter_log import filter_roughly
from ..inference.filter_problem import FilterProblem
from ..inference.solution import Solution
from ..inference.tangents import OFFSET_STD
from ..noise.encoder_noise import MAX_MEMORY_S
from .threshold import MIN_DELAY_S, PRIOR_STD_RAD
from .true_stretch import compare_with_images

TRIED_DRIFT_BEGINS = 64
"""Times tried at which a steady drift may begin."""
SIZE_ROUNDS = 4
"""Parabolas by which the size of a change is found: one holds near its points alone, and a minimum
far from them promised 1,700 nats for a drift of 5 rad, which hid a step of 2°.
"""
FIT_ROUNDS = 10
"""Rounds that fit a constant offset to images."""
TRAILING_S = (0.0, 0.25, 0.5, 1.0, 1.5)
"""s by which a filter may show a drift late."""
RANDOM_WALKS = (1e-4, 1e-5, 1e-3, 1e-7)
"""rad²/s: random-walk variances tried; the last one
is a constant offset, as of a joint homed differently.
"""


class OffsetHypothesis(NamedTuple):
    """A problem with one more offset, its cost (nats), and if it is a step or a steady drift the
    fault and what size and time cost.

    name: offset, which is a random walk, step or drift.
    """

    problem: FilterProblem
    nats: float
    fault: Fault | None = None
    prior: float = 0.0
    name: str = "offset"


def sum_free_energy(solution: Solution) -> float:
    """Free energy (nats) of a whole filtered log."""
    return float(solution.trace.nats.sum())


def measure_free_energy(problem: FilterProblem, warm: Solution) -> float:
    """Free energy (nats) of the whole log, filtered from where `warm` ended."""
    return sum_free_energy(filter_roughly(problem, warm))


def find_likeliest_changes(
    problem: FilterProblem, wandering: FilterProblem, joint: int, solved: Solution
) -> list[OffsetHypothesis]:
    """The most likely step of one joint's encoder, and its most likely steady drift from some time
    on, given the problem without and with a `wandering` offset of it.

    A step or drift that the log does not determine is left out.
    """
    off = _measure_residuals(wandering, problem, joint, solved)
    found = [
        _find_likeliest_step(problem, off, joint, solved),
        _find_constant_offset(problem, joint, solved),
    ]
    assert problem.evidence.encoders is not None
    if np.ptp(problem.evidence.encoders.t) > 2.0 * MAX_MEMORY_S:
        found.append(_find_likeliest_drift(problem, off, joint, solved))
    return [one for one in found if one is not None]


def _measure_residuals(
    posed: FilterProblem, problem: FilterProblem, joint: int, solved: Solution
) -> Array:
    """How far the problem's readings of a joint (N,) rad are from the angles of the posed one."""
    assert problem.evidence.encoders is not None
    solution = filter_roughly(posed, solved)
    angles = solution.trace.z[:, joint]
    return np.asarray(
        problem.evidence.encoders.values[:, joint] - angles[problem.timeline.encoders]
    )


def _find_likeliest_step(
    problem: FilterProblem, off: Array, joint: int, solved: Solution
) -> OffsetHypothesis | None:
    """The most likely step; off (N,) rad: residuals of readings where the offset wanders."""
    encoders = problem.evidence.encoders
    assert encoders is not None
    y = encoders.values[:, joint]
    t = encoders.t
    since, size = _fit_change(t, off, grows=False)
    # a filter takes a step for motion at first: just before, images alone tell the angle
    unsure = (t > since - MAX_MEMORY_S) & (t <= since)
    masked = np.where(unsure, np.nan, np.where(t > since, y - size, y))
    masked_off = _measure_residuals(_with_readings(problem, joint, masked), problem, joint, solved)
    # an encoder may jump while it is silent: a shift is that from the reading before
    read = np.isfinite(y)
    shifts = np.where(unsure[read], np.sign(size) * np.diff(y[read], prepend=np.nan), np.nan)
    largest = float(t[read][np.nan_to_num(shifts, nan=-np.inf).argmax()])
    begins = {_fit_change(t, masked_off, grows=False)[0], largest}
    # an encoder that is off so soon is off from the start
    steps = {one if one - t[0] >= MAX_MEMORY_S else float(t[0]): size for one in sorted(begins)}
    return _size_likeliest_change(problem, joint, solved, steps, grows=False)


def _find_constant_offset(
    problem: FilterProblem, joint: int, solved: Solution
) -> OffsetHypothesis | None:
    """The most likely offset from the start: where images tell much more than readings, a gate
    rejects them far from it, so that no offset wanders there.
    """
    encoders = problem.evidence.encoders
    assert encoders is not None
    size = _fit_constant_offset(problem, joint)
    start = float(encoders.t[0])
    return _size_likeliest_change(problem, joint, solved, {start: size}, grows=False)


def _fit_constant_offset(problem: FilterProblem, joint: int) -> float:
    """By how much (rad) a joint's encoder is off all the time, if its images are right: by
    Gauss-Newton, with weights of a Cauchy law, whose tails hold errors of many standard deviations.
    """
    encoders = problem.evidence.encoders
    assert encoders is not None
    images = [one for one in problem.evidence.sightings if one.name != "touch"]
    read = encoders.values[:, joint]
    size = 0.0
    for _ in range(FIT_ROUNDS):
        pull = 0.0
        weight = 1.0
        shifted = _with_readings(problem, joint, read - size).evidence.encoders
        assert shifted is not None
        for off, slopes, var in compare_with_images(shifted, images):
            total = var + np.square(slopes) @ problem.precision.encoder
            slope = slopes[..., joint]
            share = 1.0 / (total * (1.0 + (np.square(off) / total).sum(axis=1))[:, None])
            pull -= float((share * slope * off).sum())
            weight += float((share * np.square(slope)).sum())
        size += pull / weight
    return size


def _find_likeliest_drift(
    problem: FilterProblem, off: Array, joint: int, solved: Solution
) -> OffsetHypothesis | None:
    """The most likely steady drift; off (N,) rad: residuals of readings where the offset wanders.

    A drift stands beside a slow random walk: a walk is as likely before it begins as later, so one
    that is slow enough for the sound readings trails a steady drift.
    """
    assert problem.evidence.encoders is not None
    t = problem.evidence.encoders.t
    since, size = _fit_change(t, off, grows=True)
    rows = np.searchsorted(t, np.maximum(since - np.array(TRAILING_S), t[0] + MAX_MEMORY_S))
    slope = size / (t[-1] - since)
    drifts = {one: float(slope * (t[-1] - one)) for one in np.unique(t[rows]).tolist()}
    slow = with_walk(problem, joint, RANDOM_WALKS[1])
    return _size_likeliest_change(slow, joint, solved, drifts, grows=True)


def _size_likeliest_change(
    problem: FilterProblem, joint: int, solved: Solution, tried: Mapping[float, float], grows: bool
) -> OffsetHypothesis | None:
    """The most likely of changes {since s: size rad} of what an encoder reads, at its most likely
    size; None where the log determines none.
    """
    encoders = problem.evidence.encoders
    assert encoders is not None
    y = encoders.values[:, joint]
    t = encoders.t

    def remove_change(since: float, size: float) -> FilterProblem:
        return _with_readings(problem, joint, y - size * shape_change(t, since, grows))

    def measure_cost(since: float, size: float) -> float:
        return measure_free_energy(remove_change(since, size), solved)

    since = min(tried, key=lambda one: measure_cost(one, tried[one]))
    size = tried[since]
    least = np.inf
    more = 0.0
    for _ in range(SIZE_ROUNDS):
        nats = [measure_cost(since, size + apart) for apart in (-OFFSET_STD, 0.0, OFFSET_STD)]
        if nats[1] > least:
            # beyond where the parabola holds: back by three quarters of the way
            more *= 0.25
            size -= 3.0 * more
            continue
        least = nats[1]
        lowest = _fit_parabola_minimum(nats)
        if lowest is None:
            return None
        cost, more, std = lowest
        size += more
        if abs(more) <= OFFSET_STD:
            break
    else:
        return None
    times = len(t) if since > t[0] else 1
    size_nats = np.log1p((PRIOR_STD_RAD / std) ** 2) + (size / PRIOR_STD_RAD) ** 2
    prior = float(0.5 * size_nats + np.log(times))
    is_step = since > t[0] and not grows
    kind = FaultKind.JUMPING if is_step else FaultKind.DRIFTING
    name = problem.evidence.joints[joint]
    fault = Fault("encoders", name, kind, since, size, problem.evidence.unit, std)
    form = "drift" if grows else "step"
    return OffsetHypothesis(remove_change(since, size), cost + prior, fault, prior, form)


def shape_change(t: Array, since: Array | float, grows: bool) -> Array:
    """The share of a change that is there at t: a step, or growth from its time to the end."""
    if not grows:
        return np.asarray(t >= since, float)
    return np.asarray(np.maximum(t - since, 0.0) / np.maximum(t.max() - since, MIN_DELAY_S))


def _fit_change(t: Array, off: Array, grows: bool) -> tuple[float, float]:
    """Since when residuals (N,) at t (N,) s, NaN where missing, are best described by a change of
    this shape in place of 0, and its size at the end.
    """
    power = int(grows)
    begins = (
        np.linspace(t[0] + MAX_MEMORY_S, t[-1] - MAX_MEMORY_S, TRIED_DRIFT_BEGINS) if grows else t
    )
    rows = np.searchsorted(t, begins)

    def sum_later(values: Array, degree: int) -> Array:
        """Sums of known values times (t - begin)^degree, from each begin on."""
        known = np.where(np.isfinite(off), values, 0.0)
        sums = (np.cumsum((known * t**k)[::-1])[::-1][rows] for k in range(degree + 1))
        back = (comb(degree, k) * (-begins) ** (degree - k) for k in range(degree + 1))
        return np.asarray(sum(one * share for one, share in zip(sums, back, strict=True)))

    product = sum_later(off, power)
    square = np.maximum(sum_later(np.ones(len(t)), 2 * power), np.finfo(float).tiny)
    best = int((product**2 / square).argmax())
    rise = (t[-1] - begins[best]) ** power
    return float(begins[best]), float(product[best] / square[best] * rise)


def _fit_parabola_minimum(nats: Sequence[float]) -> tuple[float, float, float] | None:
    """Lowest cost (nats) on a parabola through three
    OFFSET_STD apart, its place from the middle, its std (rad).
    """
    below, cost, above = nats
    bend = (below - 2.0 * cost + above) / OFFSET_STD**2
    slope = (above - below) / (2.0 * OFFSET_STD)
    return None if bend <= 0.0 else (cost - 0.5 * slope**2 / bend, -slope / bend, float(bend**-0.5))


def _with_readings(problem: FilterProblem, joint: int, y: Array) -> FilterProblem:
    """The problem with other readings y (N,) rad of one encoder."""
    encoders = problem.evidence.encoders
    assert encoders is not None
    values = np.where(np.arange(encoders.values.shape[1]) == joint, y[:, None], encoders.values)
    corrected = encoders.with_corrected_readings(values)
    return replace(problem, evidence=replace(problem.evidence, encoders=corrected))


def list_random_walks(problem: FilterProblem) -> Array:
    """Random walks (M,) rad²/s of the offsets in the problem so far."""
    return (
        np.zeros(len(problem.start))
        if problem.precision.drift is None
        else np.asarray(problem.precision.drift)
    )


def with_walk(problem: FilterProblem, joint: int, walk: float) -> FilterProblem:
    """The problem with a random walk of one encoder's offset, rad²/s; 0 for no offset."""
    return with_drift(
        problem, np.where(np.arange(len(problem.start)) == joint, walk, list_random_walks(problem))
    )


def with_drift(problem: FilterProblem, drift: Array) -> FilterProblem:
    """The problem with random walks `drift` (M,) rad²/s of encoder offsets; 0 for no offset."""
    return replace(problem, precision=replace(problem.precision, drift=drift))
