"""Joints that stick and slip: each stands still until it slips, and readings lead.

A smooth motion takes slips for noise of encoders and of images, and cuts through them. Here joint j
stands still but for slips, which come at a rate λ and have the size N(0, s²). Between two instants
it has slipped or not; a reading, and an image, weigh both, and the belief is the normal
distribution with the mean and the covariance of their mixture (generalised pseudo-Bayes, Ackerson
and Fu 1970). The same backwards from the end, which sticks and slips alike, gives the smoother: of
two beliefs about either side of an instant the mixture of their products.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import copysign, erfc, sqrt, tau
from statistics import NormalDist

import numpy as np

from ...linear_algebra import mix_normals
from ...motion import START_STD
from ...types import Array
from ..factors.robust import OUTLIER_SHARE, measure_image_span
from ..factors.whole_log import LEARNED_S
from ..faults.jumping import find_evident_slips
from ..inference.filter_problem import FilterProblem
from ..measurements.long_arrays import find_finite_rows, measure_median_step
from ..measurements.records import Encoders, Sighting
from ..noise.quantisation import compute_rest_factor

TRIED_SLIPS = (
    (1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0),
    (1.0, 3.0, 10.0, 30.0),
    (1.0, 4.0, 16.0, 64.0),
)
"""Tried first: variances of readings over that of a smooth motion, sizes of slips over its standard
deviation, and slips a second.
"""
REFINING_FACTORS = (2.0, 1.4)
"""Factors by which each of these is then moved to either side. Of 18 joints of 6 logs that were
drawn from the model sizes are learned to 16 % and rates to 15 %; without, to 38 and 51 %, with 2
alone to 25 and 23 %, with 1.2 as well to 12 and 17 %.
"""
MOST_SLIPPING = 0.4
"""Share of the steps between readings in which a joint slips, from which it does not stick. Of 54
joints of drawn logs that stick by 9 and 30 times the noise each has 0.04 to 0.36, and of 54 that
turn smoothly, with white noise, errors that last 0.2 s, or play, 0.83; reaches between pauses have
0.36 to 0.72, and with 12 bit 0 to 0.47: there the evidence decides.
"""
LEAST_TAIL = 1e-300
"""Probability below which errors are no more surprising: 37 standard deviations."""


@dataclass(frozen=True, eq=False)
class StickSlip:
    """Of M joints: variance of readings white (M,) rad², size
    of slips (M,) rad, and how many come a second (M,).
    """

    white: Array
    size: Array
    rate: Array


@dataclass(frozen=True, eq=False)
class SlipBelief:
    """Beliefs at E instants: mean (E,M), cov (E,M,M), before them mean (E,M) and cov (E,M,M),
    errors of readings (E,M) in standard deviations, and nats (E,), those of images (E,), too.
    """

    mean: Array
    cov: Array
    before: Array
    before_cov: Array
    errors: Array
    nats: Array
    image_nats: Array


def smooth_slips(
    problem: FilterProblem, slips: StickSlip, scales: Sequence[float], before: SlipBelief
) -> SlipBelief:
    """The beliefs by the whole log, of those by what came up to each instant."""
    t = problem.timeline.t
    after = follow_slips(problem, slips, scales, range(len(t) - 1, -1, -1))
    return join_beliefs(t, before, after, slips)


def list_evident_slips(encoders: Encoders) -> list[Array]:
    """Sizes of each joint's evident slips."""
    return [find_evident_slips(encoders.t, column) for column in encoders.values.T]


def sticks_and_slips(encoders: Encoders, slips: StickSlip) -> bool:
    """Whether some joint stands still between slips: errors that last move at each reading."""
    slipping = -np.expm1(-slips.rate * measure_median_step(encoders.t))
    return bool((~_find_constant_joints(encoders) & (slipping < MOST_SLIPPING)).any())


def _find_constant_joints(encoders: Encoders) -> Array:
    """Joints (M,) bool whose readings never change: they tell of no noise, and of no slip."""
    return np.array([len(np.unique(y[np.isfinite(y)])) < 2 for y in encoders.values.T])


def learn_slips(encoders: Encoders, variance: Array) -> StickSlip:
    """The slips of most evidence by the encoders alone; variance
    (M,) rad²: of a reading beside a smooth motion. No reading is surer than its count, and a
    joint whose readings never change has no slips.
    """
    centre = 0.5 * (encoders.t[0] + encoders.t[-1])
    rows = np.abs(encoders.t - centre) <= 0.5 * LEARNED_S
    read = (encoders.t[rows], encoders.values[rows], encoders.relative_variance[rows])
    # readings between two counts repeat, as those of a joint that stands still do
    constant = _find_constant_joints(encoders)
    alone = variance / compute_rest_factor(encoders.t)
    counts = np.where(constant, alone, encoders.count_variance)
    least = np.stack([counts, np.zeros(len(counts)), np.zeros(len(counts))])[:, None]
    units = np.stack([variance, np.sqrt(variance), np.ones(len(counts))])[:, None]
    grid = np.array(np.meshgrid(*TRIED_SLIPS, indexing="ij")).reshape(3, -1)[..., None]
    tried = grid * np.ones(len(counts))
    # as many sizes as reach the largest slip that is evident
    evident = [slips.max(initial=0.0) for slips in list_evident_slips(encoders)]
    most = TRIED_SLIPS[1][-1]
    farther = np.log(np.maximum(evident / units[1, 0], most)) / np.log(most)
    tried[1] **= farther
    best = _choose_most_evident(read, np.maximum(tried * units, least))
    for factor in REFINING_FACTORS:
        steps = np.array([1.0 / factor, 1.0, factor])
        grid = np.array(np.meshgrid(steps, steps, steps, indexing="ij")).reshape(3, -1)[..., None]
        best = _choose_most_evident(read, np.maximum(grid * best[:, None], least))
    white, size, rate = best
    return StickSlip(white, np.where(constant, 0.0, size), rate)


def _choose_most_evident(read: tuple[Array, Array, Array], tried: Array) -> Array:
    """Of parameters (3,G,M), those (3,M) of most evidence by readings at t (N,), values (N,M), and
    relative variances (N,M).
    """
    white, size, rate = tried
    t, values, relative = read
    mean = np.broadcast_to(np.nan_to_num(values[0]), white.shape)
    var = np.full(white.shape, START_STD[0] ** 2)
    nats = np.zeros(white.shape)
    square = np.square(size)
    gaps = np.diff(t, prepend=t[0])
    for gap, value, more in zip(gaps, values, relative, strict=True):
        slips = -np.expm1(-rate * gap)
        known = np.isfinite(value)
        off = np.where(known, value, 0.0) - mean
        parts = [(np.full(white.shape, OUTLIER_SHARE / tau), 0.0, var + slips * square)]
        for share, part in ((1.0 - slips, 0.0), (slips, square)):
            sums = var + part + more * white
            gain = (var + part) / sums
            dense = (
                (1.0 - OUTLIER_SHARE)
                * share
                * np.exp(-0.5 * off * off / sums)
                / np.sqrt(tau * sums)
            )
            parts.append((np.where(known, dense, 0.0), gain * off, gain * more * white))
        total = sum(dense for dense, _, _ in parts)
        nats -= np.where(known, np.log(total), 0.0)
        step = sum(dense * moved for dense, moved, _ in parts) / total
        var = sum(dense * (left + np.square(moved - step)) for dense, moved, left in parts) / total
        mean = mean + step
    best = nats.argmin(axis=0)
    return np.asarray(tried[:, best, np.arange(tried.shape[2])])


def learn_image_noise(
    problem: FilterProblem, slips: StickSlip, order: Sequence[int]
) -> tuple[list[float], SlipBelief]:
    """Factors on the variance of each sighting's images by their evidence, halved while
    that grows, and the beliefs: a smooth motion takes slips for noise of images.
    """
    tried = [problem.precision.scale.get(one.name, 1.0) for one in problem.evidence.sightings]
    best = tried
    found = follow_slips(problem, slips, best, order)
    while True:
        tried = [0.5 * scale for scale in tried]
        after = follow_slips(problem, slips, tried, order)
        if after.image_nats.sum() >= found.image_nats.sum():
            return best, found
        best = tried
        found = after


def follow_slips(
    problem: FilterProblem, slips: StickSlip, scales: Sequence[float], order: Sequence[int]
) -> SlipBelief:
    """The beliefs at these of the problem's instants, each by what came before it in this order.

    scales: factor on the variance of each sighting's images.
    """
    line = problem.timeline
    encoders = problem.evidence.encoders
    assert encoders is not None  # joints stick by what they read
    m = len(problem.start)
    count = len(line.t)
    readings = np.full((count, m), np.nan)
    readings[line.encoders] = encoders.values
    noise = np.tile(slips.white, (count, 1))
    noise[line.encoders] *= encoders.relative_variance
    frames: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    spans = {}
    for number, (sighting, at) in enumerate(
        zip(problem.evidence.sightings, line.sightings, strict=True)
    ):
        rows = np.flatnonzero(find_finite_rows(sighting.values))
        for row in rows.tolist():
            frames[at[row]].append((number, row))
        if len(rows):
            spans[number] = measure_image_span(sighting.values[rows], sighting.var[rows])
    found = SlipBelief(
        np.empty((count, m)),
        np.empty((count, m, m)),
        np.empty((count, m)),
        np.empty((count, m, m)),
        np.full((count, m), np.nan),
        np.zeros(count),
        np.zeros(count),
    )
    mean = problem.start.copy()
    cov = np.eye(m) * START_STD[0] ** 2
    last = line.t[order[0]]
    for k in order:
        likely = -np.expm1(-slips.rate * abs(line.t[k] - last))
        last = line.t[k]
        found.before[k] = mean
        found.before_cov[k] = cov + np.diag(likely * np.square(slips.size))
        for j in range(m):
            if np.isnan(readings[k, j]):
                continue
            off = readings[k, j] - mean[j]
            square = float(slips.size[j]) ** 2
            still = float(cov[j, j] + noise[k, j])
            found.errors[k, j] = _standardise_reading(off, still, float(likely[j]), square)
            mean, cov, nats = _weigh_reading(
                mean, cov, j, off, noise[k, j], float(likely[j]), square
            )
            found.nats[k] += nats
            likely[j] = 0.0
        for number, row in frames[k]:
            sighting = problem.evidence.sightings[number]
            mean, cov, nats = _weigh_image(
                mean,
                cov,
                sighting,
                row,
                scales[number],
                likely,
                np.square(slips.size),
                spans[number],
            )
            found.nats[k] += nats
            found.image_nats[k] += nats
            likely = np.zeros(m)
        cov = cov + np.diag(likely * np.square(slips.size))
        found.mean[k] = mean
        found.cov[k] = cov
    return found


def _standardise_reading(off: float, still: float, likely: float, square: float) -> float:
    """A reading `off` rad from its mean in standard deviations: those of a normal error that is as
    rare as it is among errors of variance `still`, and with a slip of variance `square`, too.
    """
    tail = (1.0 - likely) * erfc(abs(off) / sqrt(2.0 * still))
    tail += likely * erfc(abs(off) / sqrt(2.0 * (still + square)))
    return copysign(NormalDist().inv_cdf(max(0.5 * tail, LEAST_TAIL)), off)


def _weigh_reading(
    mean: Array, cov: Array, j: int, off: float, noise: float, likely: float, square: float
) -> tuple[Array, Array, float]:
    """The belief (M,), (M,M) after joint j was read `off` rad from its mean, and the nats.

    likely: probability of a slip, of variance `square`, since the belief.
    """
    parts = []
    for share, more in ((1.0 - likely, 0.0), (likely, square)):
        row = cov[:, j].copy()
        row[j] += more
        total = row[j] + noise
        gain = row / total
        after = cov - np.outer(gain, row)
        after[j, j] += more
        dense = (
            (1.0 - OUTLIER_SHARE) * share * np.exp(-0.5 * off * off / total) / np.sqrt(tau * total)
        )
        parts.append((dense, gain * off, after))
    after = cov.copy()
    after[j, j] += likely * square
    parts.append((OUTLIER_SHARE / tau, np.zeros(len(mean)), after))
    return _merge_parts(mean, parts)


def _weigh_image(
    mean: Array,
    cov: Array,
    sighting: Sighting,
    row: int,
    scale: float,
    likely: Array,
    squares: Array,
    span: Array,
) -> tuple[Array, Array, float]:
    """The belief (M,), (M,M) after an image, and the nats.

    likely (M,): probability that each joint has slipped since the belief; one at most has ·
    span (D,): within what an outlier may be.
    """
    predicted, jac, model = sighting.model.predict(mean[None])
    off = sighting.values[row] - predicted[0]
    own = np.diag(sighting.var[row]) if sighting.cov is None else sighting.cov[row]
    own = scale * own + np.diag(model[0])
    slope = jac[0]
    cases = [(1.0 - min(float(likely.sum()), 0.5), cov)]
    for j in np.flatnonzero(likely).tolist():
        more = cov.copy()
        more[j, j] += squares[j]
        cases.append((float(likely[j]), more))
    parts = []
    for share, before in cases:
        seen = slope @ before
        total = seen @ slope.T + own
        gain = np.linalg.solve(total, seen).T
        far = float(off @ np.linalg.solve(total, off))
        log = -0.5 * (far + np.linalg.slogdet(total)[1] + len(off) * np.log(tau))
        parts.append(
            (share * np.exp(log) * (1.0 - OUTLIER_SHARE), gain @ off, before - gain @ seen)
        )
    open_cov = cov + np.diag(likely * squares)
    parts.append((OUTLIER_SHARE / float(np.prod(span)), np.zeros(len(mean)), open_cov))
    return _merge_parts(mean, parts)


def _merge_parts(
    mean: Array, parts: Sequence[tuple[float, Array, Array]]
) -> tuple[Array, Array, float]:
    """Mean and covariance of a mixture of parts (density, step
    from the mean, covariance), and the nats of what was measured.
    """
    dense, steps, covs = (np.array(one) for one in zip(*parts, strict=True))
    step, cov = mix_normals(dense / dense.sum(), steps, covs)
    return mean + step, cov, -float(np.log(dense.sum()))


def join_beliefs(t: Array, before: SlipBelief, after: SlipBelief, slips: StickSlip) -> SlipBelief:
    """The beliefs at instants t (E,) s by the whole log, of those
    by what came up to them and by what came from them on.

    Whether a joint has slipped up to the next instant is weighed for each joint alone; the mixture
    holds the most probable case, and for each joint the other one.
    """
    m = before.mean.shape[1]
    mean = before.mean.copy()
    cov = before.cov.copy()
    squares = np.square(slips.size)
    gaps = np.diff(t)[:, None]
    likely = np.clip(-np.expm1(-slips.rate * gaps), 1e-300, 1.0 - 1e-12)
    off = after.mean[1:] - mean[:-1]
    own = np.einsum("emm->em", cov[:-1] + after.cov[1:])
    odds = np.log(likely / (1.0 - likely)) - 0.5 * (
        np.square(off) * (1.0 / (own + squares) - 1.0 / own) + np.log((own + squares) / own)
    )
    has_slipped = odds > 0.0
    flips = np.concatenate([np.zeros((1, m), bool), np.eye(m, dtype=bool)])
    cases = has_slipped[:, None, :] ^ flips
    # the odds of the less probable case
    shares = np.concatenate([np.ones((len(odds), 1)), np.exp(-np.abs(odds))], axis=1)
    shares = shares / shares.sum(axis=1, keepdims=True)
    wide = after.cov[1:, None] + (cases * squares)[..., None] * np.eye(m)
    gain = np.linalg.solve(cov[:-1, None] + wide, np.broadcast_to(cov[:-1, None], wide.shape))
    gain = gain.swapaxes(-1, -2)
    steps = (gain @ off[:, None, :, None])[..., 0]
    covs = cov[:-1, None] - gain @ cov[:-1, None]
    step, cov[:-1] = mix_normals(shares, steps, covs)
    mean[:-1] += step
    return replace(before, mean=mean, cov=0.5 * (cov + cov.swapaxes(1, 2)))
