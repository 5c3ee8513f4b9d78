"""Encoder offsets: whether the log needs one, which encoder has it, and since when it drifts.

`find_suspected_encoders` scores an offset of each encoder to first order, from one filtered log.
`choose_encoder_offsets` filters the log with each hypothesis: an offset that walks at random, a
step, from which on all readings are off by a constant, or a steady drift.

Score. In a short span, innovations are those of one error e of the belief and of one offset b of
the encoders: ν = e + b in an encoder, J e in an image. Least squares, e integrated out, give b:
with W the sum of the encoders' S⁻¹, V of the images' JᵀS⁻¹J, and s = (W + V)⁻¹ W, its information
is W − W s. A filter that lags behind the arm has an e, but no b.

Steps and drifts. Time and size b are those of greatest evidence of the whole filter. A size that is
N(0, P²) a priori, P being PRIOR_STD_RAD, with standard error σ, and a time at any of N readings
after the start, cost ½ ln(1 + P²/σ²) + ½ b²/P² + ln N nats of it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import comb
from typing import NamedTuple

import numpy as np

from ...types import ALTERNATIVE_SEPARATOR, Array, Fault, FaultKind, Hypothesis
from ..inference.filter_log import filter_roughly
from ..inference.filter_pass import GATE_SIGMA
from ..inference.filter_problem import FilterProblem
from ..inference.solution import Solution
from ..inference.tangents import OFFSET_STD
from ..measurements.long_arrays import find_finite_rows
from ..measurements.records import Evidence
from ..measurements.timeline import list_span_starts
from ..noise.correlated_noise import count_effective_frames
from ..noise.encoder_noise import MAX_MEMORY_S
from ..noise.quantisation import find_reading_step
from .threshold import CERTAIN_SIGMA, EVIDENCE_THRESHOLD_NATS, MIN_DELAY_S, PRIOR_STD_RAD
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
    slow = _with_walk(problem, joint, RANDOM_WALKS[1])
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


def score_encoder_offsets(
    problem: FilterProblem, solved: Solution, walk: float, most: float = CERTAIN_SIGMA
) -> tuple[Array, Array, Array]:
    """Nats (M,) that an offset of each encoder with
    random walk `walk` rad²/s would win; 0 without images.

    Also returns that offset over spans of the log (S,M) rad, and its variance (S,M). Innovations
    count as no more than `most` standard deviations, so that single blunders do not look like an
    offset; one of many times their noise looks smaller than it is.
    """
    t = problem.timeline.t
    m = len(problem.start)
    visual = [
        k for k, sighting in enumerate(problem.evidence.sightings) if sighting.name != "touch"
    ]
    if not visual:
        return np.zeros(m), *np.zeros((2, 1, m))
    # in a span an offset walks by less than the least fault: by two standard deviations
    begins = np.unique(np.searchsorted(t, list_span_starts(t, (0.5 * OFFSET_STD) ** 2 / walk)))
    bounds = np.append(begins, len(t))
    pull, weight = _sum_encoder_innovations(solved, bounds, most)
    tracks = [_sum_track_information(problem, solved, k, bounds, most) for k in visual]
    seen = np.sum(tracks, axis=0)
    return _filter_offset_score(
        np.diff(t[begins], append=t[-1]), *_score_offsets(pull, weight, seen), walk
    )


def _score_offsets(pull: Array, weight: Array, seen: Array) -> tuple[Array, Array]:
    """Slope and curvature (S,M) of the evidence in each
    encoder's offset, from the sums of encoders and of tracks.

    With W the encoders' information and A that of all others, 1 - (A + W)⁻¹W is (A + W)⁻¹A: as a
    difference it would be rounding where encoders know far more than images.
    """
    m = weight.shape[1]
    # known to a radian where nothing is measured
    others = seen[..., :m] + np.eye(m)
    known = np.linalg.inv(others + np.eye(m) * weight[:, None])
    read = np.divide(pull, weight, out=np.zeros_like(pull), where=weight > 0.0)
    left = (others @ read[..., None])[..., 0] - seen[..., m]
    score = weight * (known @ left[..., None])[..., 0]
    return score, weight * np.einsum("skj,sjk->sk", known, others)


def _sum_encoder_innovations(solved: Solution, bounds: Array, most: float) -> tuple[Array, Array]:
    """Sums (S,M) of S⁻¹ν, clipped at `most` standard deviations, and of S⁻¹ over spans."""
    d = solved.trace.encoder_d
    spread = np.einsum("eii->ei", solved.trace.prior_cov) + solved.readings.encoder_var
    each = np.clip(d, -most, most) / np.sqrt(spread), 1.0 / spread
    rows = (np.where(np.isfinite(d), a, 0.0) for a in each)
    pull, weight = (np.add.reduceat(a, bounds[:-1]) for a in rows)
    return pull, weight


def _sum_track_information(
    problem: FilterProblem, solved: Solution, track: int, bounds: Array, most: float
) -> Array:
    """Sums of a track's JᵀS⁻¹J, and of JᵀS⁻¹ν clipped alike, over spans: (S,M,M+1)."""
    events, jac, nu, white = _whiten_track(problem, solved, track)
    far = np.sqrt((nu * white[..., -1]).mean(axis=1))
    white[..., -1] /= np.maximum(far / most, 1.0)[:, None]
    each = (jac.swapaxes(1, 2) @ white).cumsum(axis=0)
    return np.diff(np.insert(each, 0, 0.0, axis=0)[np.searchsorted(events, bounds)], axis=0)


def _whiten_track(
    problem: FilterProblem, solved: Solution, track: int
) -> tuple[Array, Array, Array, Array]:
    """Of a track's images: their instants (F,), slopes J (F,D,M), innovations ν (F,D), and S⁻¹J
    beside S⁻¹ν (F,D,M+1).
    """
    readings = solved.readings
    trace = solved.trace
    sighting = problem.evidence.sightings[track]
    seen = find_finite_rows(sighting.values)
    size = np.arange(sighting.values.shape[1])
    events = problem.timeline.sightings[track][seen]
    x, cov = (a[events] for a in (trace.prior, trace.prior_cov))
    y, jac, var = (a[events, track, : len(size)] for a in (readings.y, readings.jac, readings.var))
    s = jac @ cov @ jac.swapaxes(1, 2)
    nu = y[..., None] - jac @ x[..., None]
    s[:, size, size] += var + _measure_correlated_error(solved, track, seen)
    return events, jac, nu[..., 0], np.linalg.solve(s, np.concatenate([jac, nu], axis=2))


def _rejects_images(problem: FilterProblem, solved: Solution) -> bool:
    """Whether most images are farther from where readings put them than a filter's gate allows: the
    noise that it was given then says nothing of them.
    """
    far = [np.zeros(0)]
    for k, sighting in enumerate(problem.evidence.sightings):
        if sighting.name != "touch":
            _, _, nu, white = _whiten_track(problem, solved, k)
            far.append(np.sqrt((nu * white[..., -1]).mean(axis=1)))
    rejected = np.concatenate(far) > GATE_SIGMA
    return bool(rejected.size and rejected.mean() > 0.5)


def _measure_correlated_error(solved: Solution, track: int, seen: Array) -> Array:
    """Variance (F,D) added for correlated model error,
    so that frames of like postures count as one.
    """
    points = solved.tangents.points[track][seen]
    model = solved.tangents.model_var[track][seen]
    # within 0.3 rad errors of the body model are correlated, and look like an offset
    duplicates = count_effective_frames(
        np.exp(-np.linalg.norm(np.diff(points, axis=0), axis=1) / 0.3)
    )
    return np.asarray(model * (2.0 * duplicates - 2.0)[:, None])


def _filter_offset_score(
    steps: Array, score: Array, weight: Array, walk: float
) -> tuple[Array, Array, Array]:
    """Filter each offset over spans of `steps` (S,) s from
    scores and weights (S,M); returns as `score_encoder_offsets` does.
    """
    offset = np.zeros(score.shape[1])
    var = np.full(score.shape[1], OFFSET_STD**2)
    filtered = []
    for pull, stiff, step in zip(score, weight, steps, strict=True):
        before = offset
        ahead = var + walk * step
        share = 1.0 + stiff * ahead
        offset = before + ahead * (pull - stiff * before) / share
        var = ahead / share
        nats = 0.5 * (offset * offset / var - before * before / ahead - np.log(share))
        filtered.append((nats, offset, var))
    nats, offset, var = np.stack(filtered).swapaxes(0, 1)
    return nats.sum(axis=0), offset, var


def find_suspected_encoders(
    problem: FilterProblem, solved: Solution
) -> tuple[FilterProblem, Array]:
    """The problem with the hypotheses of an offset of each encoder, to first order, and which (M,)
    bool win EVIDENCE_THRESHOLD_NATS.
    """
    gain, offset, var = score_encoder_offsets(problem, solved, RANDOM_WALKS[0])
    least = find_smallest_fault(problem.evidence)
    certain = _mark_significant_offsets(offset, var, least)
    if ((gain > EVIDENCE_THRESHOLD_NATS) & ~certain.any(axis=0)).any():
        # of readings with little noise, innovations that are cut show no offset of that size
        _, offset, var = score_encoder_offsets(problem, solved, RANDOM_WALKS[0], np.inf)
        certain = certain | _mark_significant_offsets(offset, var, least)
    found = (("offset", j, nats, False) for j, nats in enumerate(gain)) if gain.any() else ()
    return _add_hypotheses(problem, found), np.asarray(
        (gain > EVIDENCE_THRESHOLD_NATS) & certain.any(axis=0) & (_list_random_walks(problem) == 0)
    )


def choose_encoder_offsets(
    problem: FilterProblem,
    solved: Solution,
    suspected: Array,
    relearn: Callable[[FilterProblem], FilterProblem],
) -> FilterProblem:
    """Add one offset after the other while each wins
    EVIDENCE_THRESHOLD_NATS, and the hypotheses compared.

    solved: a solution of the problem, from which each hypothesis is filtered · suspected (M,) bool:
    the encoders tried first, at least one · relearn: gives a problem noise by its own evidence.
    Steps are taken out of the readings, and are faults of the evidence. Joints with an offset are
    keys of the problem's `alternatives`.
    """
    found = problem
    nats = measure_free_energy(problem, solved)
    while suspected.any():
        walks = {
            j: measure_free_energy(_with_walk(found, j, RANDOM_WALKS[0]), solved)
            for j in np.flatnonzero(suspected).tolist()
        }
        found = _add_hypotheses(
            found, (("offset", j, nats - walk, False) for j, walk in walks.items())
        )
        wins = min(walks.values()) <= nats - EVIDENCE_THRESHOLD_NATS
        if not wins and found.alternatives:
            break
        # a gate rejects the readings after a large step, so that
        # no offset wanders there: only a step is left to try
        near = _list_near_optimal_joints(walks) if wins else list(walks)
        # the kind of offset is chosen before a further one
        # is tried: one that wanders too freely hides others
        offsets = {j: _find_best_offset(found, j, solved, relearn) for j in near}
        costs = {j: offset.nats for j, offset in offsets.items()}
        if min(costs.values()) > nats - EVIDENCE_THRESHOLD_NATS:
            break
        # among indistinguishable joints take the smallest
        # walk: a larger one follows errors of the body model
        near = sorted(_list_near_optimal_joints(costs))
        joint = min(near, key=lambda j: (_list_random_walks(offsets[j].problem)[j], costs[j]))
        compared = [(offsets[j].name, j, nats - costs[j], j == joint) for j in offsets]
        found = _add_hypotheses(_with_offset_hypothesis(offsets[joint], joint, near), compared)
        nats = costs[joint]
        # once one offset is modelled, another may show
        suspected = (_list_random_walks(found) == 0) & ~np.isin(
            np.arange(len(suspected)), list(found.alternatives)
        )
    if len(found.alternatives) < 2:
        return found
    return _reconsider_offsets(problem, found, nats, solved, relearn)


def _reconsider_offsets(
    problem: FilterProblem,
    found: FilterProblem,
    nats: float,
    solved: Solution,
    relearn: Callable[[FilterProblem], FilterProblem],
) -> FilterProblem:
    """Each of several offsets again, given the others, if all of them together then cost less.

    The first was chosen while the others were unknown, and may have taken up part of them.
    """
    again = found
    again_nats = nats
    for joint, others in found.alternatives.items():
        offset = _find_best_offset(
            _remove_joint_offset(problem, again, joint), joint, solved, relearn
        )
        again = _with_offset_hypothesis(offset, joint, [joint, *others])
        again_nats = offset.nats
    return again if again_nats < nats else found


def _remove_joint_offset(problem: FilterProblem, found: FilterProblem, joint: int) -> FilterProblem:
    """The problem with the offsets found but for one joint's, whose readings are as they were."""
    assert problem.evidence.encoders is not None and found.evidence.encoders is not None
    own = np.arange(len(problem.start)) == joint
    values = np.where(own, problem.evidence.encoders.values, found.evidence.encoders.values)
    name = problem.evidence.joints[joint]
    known = problem.evidence.faults
    kept = [fault for fault in found.evidence.faults if fault in known or fault.names[0] != name]
    encoders = replace(found.evidence.encoders, values=values)
    evidence = replace(found.evidence, encoders=encoders, faults=tuple(kept))
    alternatives = {j: others for j, others in found.alternatives.items() if j != joint}
    return with_drift(
        replace(found, evidence=evidence, alternatives=alternatives),
        np.where(own, _list_random_walks(problem), _list_random_walks(found)),
    )


def _list_near_optimal_joints(costs: Mapping[int, float]) -> list[int]:
    """Joints whose cost is within EVIDENCE_THRESHOLD_NATS of the least."""
    return [
        joint
        for joint, nats in costs.items()
        if nats < min(costs.values()) + EVIDENCE_THRESHOLD_NATS
    ]


def _add_hypotheses(
    problem: FilterProblem, found: Iterable[tuple[str, int, float, bool]]
) -> FilterProblem:
    """The problem with further hypotheses: kind, joint, nats
    won, chosen or not; the last one of a joint and kind.
    """
    evidence = problem.evidence
    each = (
        Hypothesis(f"encoder {kind}", evidence.joints[j], float(nats), EVIDENCE_THRESHOLD_NATS, won)
        for kind, j, nats, won in found
    )
    new = {(one.name, one.about): one for one in each}
    known = [new.pop((one.name, one.about), one) for one in evidence.hypotheses]
    return replace(problem, evidence=replace(evidence, hypotheses=(*known, *new.values())))


def _with_offset_hypothesis(offset: OffsetHypothesis, joint: int, near: list[int]) -> FilterProblem:
    """The problem with an offset of one joint, or of those in `near`, which explain as much."""
    evidence = offset.problem.evidence
    others = tuple(j for j in near if j != joint)
    if offset.fault is not None:
        size = np.nan if others else offset.fault.size
        fault = replace(
            offset.fault, name=_name_alternatives(evidence.joints, joint, others), size=size
        )
        evidence = replace(evidence, faults=(*evidence.faults, fault))
    return replace(
        offset.problem,
        evidence=evidence,
        alternatives={**offset.problem.alternatives, joint: others},
    )


def _name_alternatives(names: tuple[str, ...], joint: int, others: tuple[int, ...]) -> str:
    """A faulty joint's name, with those of others that the log cannot distinguish from it."""
    return ALTERNATIVE_SEPARATOR.join(names[j] for j in (joint, *others))


def _find_best_offset(
    problem: FilterProblem,
    joint: int,
    solved: Solution,
    relearn: Callable[[FilterProblem], FilterProblem],
) -> OffsetHypothesis:
    """The best random walk of one joint's offset, or its step or steady drift if that costs less.

    These are compared with noise learned again with the offset: the problem's own has absorbed it.
    """
    allowed = with_drift(
        relearn(_with_walk(problem, joint, RANDOM_WALKS[0])), _list_random_walks(problem)
    )
    walks = (_with_walk(allowed, joint, walk) for walk in RANDOM_WALKS)
    hypotheses = (OffsetHypothesis(one, measure_free_energy(one, solved)) for one in walks)
    best = min(hypotheses, key=lambda offset: offset.nats)
    changes = find_likeliest_changes(allowed, best.problem, joint, solved)
    offset = min((best, *changes), key=lambda one: one.nats)
    # against no offset it counts with the problem's noise: less of it makes an offset of a poor
    # body's errors; with its own where the problem's is that of a filter which rejects all images
    found = replace(
        offset.problem, precision=replace(problem.precision, drift=offset.problem.precision.drift)
    )
    usual = offset._replace(problem=found, nats=measure_free_energy(found, solved) + offset.prior)
    lost = _rejects_images(problem, solved)
    return min((usual, offset), key=lambda one: one.nats) if lost else usual


def _list_random_walks(problem: FilterProblem) -> Array:
    """Random walks (M,) rad²/s of the offsets in the problem so far."""
    return (
        np.zeros(len(problem.start))
        if problem.precision.drift is None
        else np.asarray(problem.precision.drift)
    )


def _with_walk(problem: FilterProblem, joint: int, walk: float) -> FilterProblem:
    return with_drift(
        problem, np.where(np.arange(len(problem.start)) == joint, walk, _list_random_walks(problem))
    )


def with_drift(problem: FilterProblem, drift: Array) -> FilterProblem:
    """The problem with random walks `drift` (M,) rad²/s of encoder offsets; 0 for no offset."""
    return replace(problem, precision=replace(problem.precision, drift=drift))


def choose_preset_walks(setting: str, evidence: Evidence) -> Array | None:
    """Random walks (M,) rad²/s set beforehand: for all joints if `on`, for encoders that are wrong
    after a jump if `auto`.

    Without images nothing tells what is left of a jump: its size's variance is all that is known.
    """
    names = evidence.joints
    seen = any(sighting.name != "touch" for sighting in evidence.sightings)
    jumped = {
        fault.name
        for fault in evidence.faults
        if fault.kind == FaultKind.JUMPING and fault.until is None and seen
    }
    if setting == "on" or (setting == "auto" and jumped):
        return np.array(
            [RANDOM_WALKS[1] if setting == "on" or name in jumped else 0.0 for name in names]
        )
    return None


def measure_repair_variance(problem: FilterProblem, offset_var: Array | None) -> Array:
    """Variance (E,M) rad² of angles by the sizes ± std
    of jumps that were taken out of earlier readings.

    offset_var (E,M) rad²: of offsets in the state, or None. Images that turned an offset's prior
    variance V into P hold the information 1/P − 1/V. They hold it of what is left of the jump, too:
    with a prior V + std² the variance would be 1/(1/(V + std²) + 1/P − 1/V), and P less is added.
    """
    t = problem.timeline.t
    walks = _list_random_walks(problem)
    names = problem.evidence.joints
    added = np.zeros((len(t), len(names)))
    for fault in problem.evidence.faults:
        joint = fault.names[0]
        if fault.sense != "encoders" or fault.std is None or joint not in names:
            continue
        column = names.index(joint)
        left = np.full(len(t), fault.std**2)
        if offset_var is not None and walks[column] > 0.0:
            prior = OFFSET_STD**2 + walks[column] * (t - t[0])
            known = np.minimum(offset_var[:, column], prior)
            left = 1.0 / (1.0 / (prior + fault.std**2) + 1.0 / known - 1.0 / prior) - known
        added[:, column] += np.where((t >= fault.since) & (t < fault.end), left, 0.0)
    return added


def find_smallest_fault(evidence: Evidence) -> Array | float:
    """Smallest offsets (M,) that count as faults, in the
    readings' unit: sound encoders are off by half a count.

    An encoder that never moved is assumed to have the largest step of the others.
    """
    encoders = evidence.encoders
    least = OFFSET_STD / evidence.rad_per_unit
    if encoders is None:
        return least
    columns = [column[np.isfinite(column)] for column in encoders.as_read.values.T]
    steps = [find_reading_step(y) for y in columns]
    steps_shown = [
        step if len(y) and np.ptp(y) else max(steps) for step, y in zip(steps, columns, strict=True)
    ]
    return np.maximum(least, steps_shown)


def _mark_significant_offsets(offset: Array, var: Array, least: Array | float) -> Array:
    """Where offsets (N,M) with variances (N,M) are
    significant and at least the smallest fault, `least` (M,) rad.
    """
    return np.asarray(np.abs(offset) > np.maximum(least, CERTAIN_SIGMA * np.sqrt(var)))


def list_drifting_encoders(problem: FilterProblem, offset: Array, var: Array) -> tuple[Fault, ...]:
    """Return drifting encoders, since when and how far, from offsets and their variances (N,M).

    Where another joint's offset explains nearly as much, both are named and the size is NaN.
    """
    t = problem.timeline.t
    walks = _list_random_walks(problem)
    names = problem.evidence.joints
    found = []
    certain = _mark_significant_offsets(offset, var, find_smallest_fault(problem.evidence))
    stepped = [
        (joint, *others) for joint, others in problem.alternatives.items() if not walks[joint]
    ]
    known = (fault.name for fault in problem.evidence.faults if fault.sense == "encoders")
    faulty = {*known, *(names[j] for joints in stepped for j in joints)}
    for joint, name in enumerate(names):
        if name in faulty:
            continue
        off = certain[:, joint]
        lasting = off & (np.cumsum(off[::-1])[::-1] > 0.5 * np.arange(len(t), 0, -1))
        if lasting.any():
            alternatives = problem.alternatives.get(joint, ())
            # the largest that is certain
            at = int((np.abs(offset[:, joint]) - CERTAIN_SIGMA * np.sqrt(var[:, joint])).argmax())
            size, std = (
                (np.nan, None)
                if alternatives
                else (float(offset[at, joint]), float(np.sqrt(var[at, joint])))
            )
            either = _name_alternatives(names, joint, alternatives)
            since = float(t[lasting.argmax()])
            found.append(
                Fault(
                    "encoders", either, FaultKind.DRIFTING, since, size, problem.evidence.unit, std
                )
            )
    return tuple(found)
