"""A log that its hardware's errors explain: posed
as factors, explained, and solved at every instant.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...kinematics.calibration import CHI_SQUARE_MEDIANS
from ...types import Array
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS, PRIOR_STD_RAD
from ..inference.filter_problem import FilterProblem
from ..inference.tangents import OFFSET_STD
from ..measurements.records import Encoders, Sighting, unmix_rows
from ..noise.lasting_error import MOST_COUNTS
from .columns import EncoderShift
from .encoder_error import LEAST_STD, JointNoise
from .factor_problem import FactorProblem, LastingPrior, Noise
from .gauss_newton import Solution, path_of, solve
from .hypotheses import FIRST_S, Explanation, explain, fit_white_noise, with_lasting
from .images import ImageRows, Images
from .load import WIDE_BEND, Load, count_groups
from .noise_search import Learned
from .robust import believed, image_span, left_out, outlier_nats
from .solve import Marginals, filtered, predicted
from .timed_columns import list_timed_loads

CLOSEST_S = 4e-3
"""s: instants closer than this share a knot, because the
information of motion grows with the fifth power of a step.
"""
COARSE_S = 0.01
"""s between the knots that noise is learned on, at least:
images, and instants where there are none for long.
"""
WEIGHING = 3
"""Rounds of linearising before readings are weighed."""
SPARSE_S = 0.1
"""s between the knots that noise is learned on where no images are."""
LEARNED_S = 60.0
"""s of a log that noise is learned from; longer ones give their middle."""
ORDER = 3
"""White jerk: white acceleration takes the noise of motors for motion."""
TURN = np.array([2.0 * np.pi])
"""rad: within what an outlier of an encoder may be."""
USUAL_STD = 4e-3
"""rad: of errors that last where readings are weighed before these are known."""
REST_SIGMAS = 4.0
"""Standard deviations of readings by which a joint that rests seems to turn at most."""
FIRST_PROCESS = 10.0
"""rad²/s⁵ with which the search begins where the encoders give none."""


@dataclass(frozen=True, eq=False)
class Instants:
    """Beliefs at a timeline's E instants.

    angles, rates, offsets (E,M), cov (E,M,M) of the links · nats (E,) of the measurements there ·
    before (E,M) and its cov (E,M,M): by what came earlier, or by the rest of the log ·
    encoder_errors (E,M), in standard deviations.
    """

    angles: Array
    rates: Array
    offsets: Array
    cov: Array
    nats: Array
    before: Array
    before_cov: Array
    encoder_errors: Array


@dataclass(frozen=True, eq=False)
class ExplainedLog:
    """A log and what explains it: the problem on its finest
    knots, the explanation, −ln p with outliers included.
    """

    fine: FactorProblem
    explanation: Explanation
    nats: float

    @property
    def noise(self) -> Noise:
        """The noise by evidence."""
        return self.explanation.learned.noise

    @property
    def senses(self) -> tuple[str, ...]:
        """Names of the senses that show something."""
        return tuple(one.name for one in self.fine.sightings)

    def with_white_noise(self) -> "ExplainedLog":
        """The same log by white noise alone."""
        return replace(self, explanation=_explain_by_noise(self.fine, self.explanation.white))


@dataclass(frozen=True, eq=False)
class SolvedLog:
    """Beliefs at the instants, and places {sense}: where its images were expected.

    A place has mean (F,D), covariance (F,D,D) and the model's variance (F,D), by what came earlier
    or by the rest of the log, without the image's own noise.
    """

    instants: Instants
    places: Mapping[str, tuple[Array, Array, Array]]


def explain_log(
    problem: FilterProblem, halves: Array, lasting: LastingPrior, loads: tuple[Load, ...]
) -> ExplainedLog | None:
    """Explain a log by white noise alone, or by errors of
    its hardware; None where it has no readings or no images.

    problem: with the encoder offsets that were found · halves (M,)
    rad: half of each joint's play in the exploration · lasting: errors of
    encoders before the log · loads: columns of a load.
    """
    posed = _pose_log(problem)
    if posed is None:
        return None
    fine, coarse, noise = posed
    encoders = _posed_encoders(problem)
    found = explain(
        coarse,
        replace(noise, prior=lasting),
        _usual_step(encoders),
        partial(_is_of_counts, encoders=encoders),
        halves,
        loads,
    )
    return ExplainedLog(fine, found, found.learned.nats + _outliers(coarse))


def explain_by_white_noise(problem: FilterProblem) -> ExplainedLog | None:
    """Explain a log by white noise alone; None where it has no readings or no images."""
    posed = _pose_log(problem)
    if posed is None:
        return None
    fine, coarse, noise = posed
    white = fit_white_noise(coarse, noise, _usual_step(_posed_encoders(problem)))
    return ExplainedLog(fine, _explain_by_noise(fine, white), white.nats + _outliers(coarse))


def _explain_by_noise(problem: FactorProblem, white: Learned) -> Explanation:
    """White noise as what explains a log."""
    return Explanation(problem.columns, white, white, 0.0, 0.0, {})


def _posed_encoders(problem: FilterProblem) -> Encoders:
    """The encoders of a log that is posed: it has some."""
    assert problem.evidence.encoders is not None
    return problem.evidence.encoders


def _usual_step(encoders: Encoders) -> float:
    """The usual time (s) from one reading to the next."""
    return float(np.median(np.diff(encoders.t)))


def resembles_load(problem: FilterProblem, without: FilterProblem, loads: tuple[Load, ...]) -> bool:
    """Whether white noise and a load explain a log about as well as white noise and encoder
    offsets, compared without learning, which takes ten times as long. In simulation, drifts won by
    130 nats and more, joints homed differently by 17 and 22, and payloads lost by 40 and 66.

    problem, without: with the encoder offsets that were found, and without.
    """
    posed = _pose_log(problem)
    alone = _pose_log(without)
    if posed is None or alone is None:
        return False
    _, shifted, its_noise = posed
    offset = solve(shifted, its_noise, rounds=WEIGHING).nats + _outliers(shifted)
    _, coarse, noise = alone
    path = path_of(coarse, noise, solve(coarse, noise, rounds=WEIGHING).beliefs)
    wide = replace(noise, groups=(WIDE_BEND,) * count_groups(loads))
    for timed, cost in list_timed_loads(coarse, noise, path, loads):
        bent = replace(coarse, columns=(*coarse.columns, *timed))
        nats = solve(bent, wide, path, rounds=WEIGHING).nats + _outliers(coarse) + cost
        if nats - offset < EVIDENCE_THRESHOLD_NATS:
            return True
    return False


def _pose_log(problem: FilterProblem) -> tuple[FactorProblem, FactorProblem, Noise] | None:
    """The log on fine and on coarse knots, its readings and images
    weighed, and its first noise; None without readings or images.
    """
    encoders = problem.evidence.encoders
    sightings = tuple(
        one for one in problem.evidence.sightings if np.isfinite(one.values).all(axis=1).any()
    )
    if encoders is None or not sightings or not np.isfinite(encoders.values).any():
        return None
    fine = _posed(problem, encoders, sightings, _thinned(problem.timeline.t, CLOSEST_S))
    noise = _first_noise(problem, len(sightings))
    # a joint that rests may bend, too
    fine = _weighed(fine, with_lasting(replace(noise, resting=None), USUAL_STD), rough=True)
    return fine, _middle(fine), noise


def solve_log(problem: FilterProblem, found: ExplainedLog, causal: bool) -> SolvedLog:
    """The beliefs at each instant by what came before (causal) or by the whole log."""
    fine = replace(found.explanation.settle_columns(found.fine), nearest=not causal)
    fine = _weighed(fine, found.noise, rough=False)
    solution = solve(fine, found.noise, causal=causal)
    instants = _at_instants(problem, fine, solution, causal)
    every = enumerate(found.senses)
    return SolvedLog(
        instants,
        {name: _places(problem, instants, solution, number, causal) for number, name in every},
    )


def _outliers(problem: FactorProblem) -> float:
    """−ln p of readings and images as far as they are outliers."""
    assert problem.believed is not None and problem.images_believed is not None
    known = np.isfinite(problem.values)
    total = outlier_nats(problem.believed[known], TURN)
    for one, share in zip(problem.sightings, problem.images_believed, strict=True):
        seen = np.isfinite(one.values).all(axis=1)
        total += outlier_nats(share[seen], image_span(one.values[seen], one.var[seen]))
    return total


def _is_of_counts(noise: Noise, encoders: Encoders) -> bool:
    """Whether what lasts is no more than whole counts make, which white noise has already."""
    joints = noise.joints
    return joints.error is not None and bool(
        (np.square(joints.error) < MOST_COUNTS * encoders.count_variance)[joints.learned].all()
    )


def _posed(
    problem: FilterProblem, encoders: Encoders, sightings: tuple[Sighting, ...], knots: Array
) -> FactorProblem:
    """The log on these knots (K,) s, about no path yet."""
    return FactorProblem(
        knots,
        encoders.t,
        encoders.values,
        encoders.relative_variance,
        problem.start,
        sightings,
        tuple(_repaired_steps(problem)),
    )


def _repaired_steps(problem: FilterProblem) -> Iterator[EncoderShift]:
    """Steps that were taken out of readings: what is
    left of each is known to its standard deviation.
    """
    names = problem.evidence.joints
    for fault in problem.evidence.faults:
        joint = fault.names[0]
        if fault.sense == "encoders" and fault.std is not None and joint in names:
            yield EncoderShift(
                "repaired step", fault.std, joint=names.index(joint), since=fault.since
            )


def _thinned(t: Array, least: float) -> Array:
    """Times (K,) of t (E,) s that are at least so far apart."""
    kept = []
    last = -np.inf
    for one in t.tolist():
        if one - last >= least:
            kept.append(one)
            last = one
    return np.array(kept)


def _middle(fine: FactorProblem) -> FactorProblem:
    """The log, or its middle, on knots at its images."""
    centre = 0.5 * (fine.knots[0] + fine.knots[-1])
    begin = centre - LEARNED_S / 2
    end = centre + LEARNED_S / 2
    seen = [one.t[np.isfinite(one.values).all(axis=1)] for one in fine.sightings]
    spread = np.arange(fine.knots[0], fine.knots[-1], SPARSE_S)
    images = np.sort(np.concatenate(seen))
    alone = (
        np.abs(spread[:, None] - images[None]).min(axis=1) > SPARSE_S
        if len(images)
        else spread >= 0
    )
    ends = [fine.knots[0], fine.knots[-1]]
    t = np.unique(np.concatenate([images, spread[alone], ends]))
    knots = _thinned(t[(t >= begin) & (t <= end)], COARSE_S)
    rows = (fine.t >= knots[0] - 1e-9) & (fine.t <= knots[-1] + 1e-9)
    sightings = []
    shares = []
    assert fine.images_believed is not None and fine.believed is not None
    for one, share in zip(fine.sightings, fine.images_believed, strict=True):
        inside = (one.t >= knots[0]) & (one.t <= knots[-1])
        shares.append(share[inside])
        sightings.append(one.select_rows(inside))
    return replace(
        fine,
        knots=knots,
        t=fine.t[rows],
        values=fine.values[rows],
        relative=fine.relative[rows],
        believed=fine.believed[rows],
        sightings=tuple(sightings),
        images_believed=tuple(shares),
    )


def _first_noise(problem: FilterProblem, sights: int) -> Noise:
    """White noise with which the search begins; a joint whose offset was found has it as a walk of
    its encoder: what is left of it where it was taken out of the readings, or all of it.
    """
    precision = problem.precision
    m = len(problem.start)
    process = np.full(m, FIRST_PROCESS)
    if precision.learned is not None:
        process = np.clip(precision.learned[ORDER - 2].process, 1e-2, 1e3)
    drift = np.zeros(m) if precision.drift is None else precision.drift
    walks = drift > 0.0
    far = np.full(m, PRIOR_STD_RAD)
    far[[step.joint for step in _repaired_steps(problem)]] = OFFSET_STD
    seconds = np.where(walks, 2.0 * far**2 / np.where(walks, drift, 1.0), FIRST_S)
    error = np.where(walks, far, LEAST_STD) if walks.any() else None
    joints = JointNoise(
        ORDER, precision.encoder, process, error, seconds, np.zeros(m, bool), np.zeros(m, bool)
    )
    return Noise(joints, (1.0,) * sights, usual=joints, resting=find_resting_joints(problem))


def measure_turns(encoders: Encoders) -> Array:
    """How far each joint turns (M,) rad, without the tenth of its readings farthest off."""
    known = (column[np.isfinite(column)] for column in encoders.values.T)
    return np.array([np.ptp(np.quantile(one, [0.05, 0.95])) if len(one) else 0.0 for one in known])


def find_resting_joints(problem: FilterProblem) -> Array:
    """Joints (M,) bool that turn by no more than their encoders' noise, of which nine
    tenths are within 3.3 standard deviations, while others turn; none of an arm at rest.
    """
    encoders = _posed_encoders(problem)
    rest = measure_turns(encoders) < REST_SIGMAS * np.sqrt(problem.precision.encoder)
    return np.asarray(rest & ~rest.all())


def _weighed(fine: FactorProblem, noise: Noise, rough: bool) -> FactorProblem:
    """The problem with the share that is believed of each reading and image.

    rough: before the noise is known, images are judged by what most of them are off.
    """
    open_problem = replace(fine, believed=None, images_believed=None)
    solution = solve(open_problem, noise, rounds=WEIGHING)
    fine = _with_shares(fine, solution, noise, rough)
    # an outlier no longer hides another, nor a sound reading
    solution = solve(fine, noise, path_of(fine, noise, solution.beliefs), rounds=WEIGHING)
    return _with_shares(fine, solution, noise, rough)


def _with_shares(
    fine: FactorProblem, solution: Solution, noise: Noise, rough: bool
) -> FactorProblem:
    """Shares by what the rest of the log predicts."""
    beliefs = solution.beliefs
    joints = noise.joints
    after = np.clip(np.searchsorted(fine.knots, fine.t), 0, len(fine.knots) - 1)
    before = np.maximum(after - 1, 0)
    knot = np.where(fine.t - fine.knots[before] < fine.knots[after] - fine.t, before, after)
    mean, own, settled = _expect_readings(fine, solution, beliefs, knot)
    share = np.ones(fine.values.shape)
    used = solution.linear.problem.believed
    for j in range(len(fine.start)):
        known = np.isfinite(fine.values[:, j])
        var = (joints.white[j] * fine.relative[known, j])[:, None, None]
        weighed = var if used is None else var / used[known, j][:, None, None]
        residual = (fine.values[known, j] - mean[known, j])[:, None]
        parts = (one[known, j][:, None, None] for one in (own, settled))
        rest, spread = left_out(residual, weighed, *parts)
        # what the others predict, and this one's own noise if it is sound
        spread = spread - weighed + var
        share[known, j] = believed(rest, np.maximum(spread, var), TURN)
    shares: list[Array] = []
    for images, linear in zip(solution.linear.problem.images, solution.linear.rows, strict=True):
        scale = noise.scales[len(shares)]
        expected = _expect_images(fine, images, linear, beliefs)
        shares.append(_image_shares(images, linear, expected, scale, rough))
    return replace(fine, believed=share, images_believed=tuple(shares))


def _expect_images(
    problem: FactorProblem, images: Images, rows: ImageRows, beliefs: Marginals
) -> tuple[Array, Array, Array]:
    """Where a sense's images are believed: mean (F,D), covariance (F,D,D) by what images change,
    and by sizes of columns that are settled.
    """
    mean, own, by_sizes = beliefs.split_rows(rows.slopes, images.knots, rows.right[..., 1:])
    if problem.settled is None:
        return mean, own + by_sizes, np.zeros_like(own)
    return mean, own, by_sizes


def _image_shares(
    images: Images, rows: ImageRows, expected: tuple[Array, Array, Array], scale: float, rough: bool
) -> Array:
    """Shares (N,) of a sense's images, which are expected as of `_expect_images`."""
    mean, cov, settled = expected
    one = np.eye(mean.shape[1])
    plain = (scale * rows.var)[..., None] * one
    used = plain / images.believed[:, None, None]
    rest, spread = left_out(rows.right[..., 0] - mean, used, cov, settled)
    spread = spread - used + plain
    if rough:
        square = np.einsum("fd,fd->f", rest, np.linalg.solve(spread, rest[..., None])[..., 0])
        usual = CHI_SQUARE_MEDIANS[min(mean.shape[1], max(CHI_SQUARE_MEDIANS))]
        spread = spread * max(1.0, float(np.median(square)) / usual)
    span = image_span(images.values, rows.var)
    share = np.ones(len(images.sighting.t))
    share[images.frames] = believed(rest, spread, span)
    return share


def _reading_rows(joints: JointNoise, ahead: Array, size: int) -> Array:
    """What encoders read, as rows (N,M,S) on the state of a knot `ahead` (N,) s before."""
    m = len(joints.white)
    p = joints.states
    rows = np.zeros((len(ahead), m, size))
    stands = replace(joints, at_link=~joints.at_link).stands(ahead)
    for j in range(m):
        rows[:, j, j * p : (j + 1) * p] = stands[:, j]
    return rows


def _expect_readings(
    fine: FactorProblem, solution: Solution, beliefs: Marginals, knot: Array
) -> tuple[Array, Array, Array]:
    """What encoders read, from the beliefs at a knot (N,) close to each reading, with what columns
    change in readings: mean (N,M), variance (N,M) by what readings change, and by sizes of columns
    that are settled.
    """
    joints = solution.linear.noise.joints
    rows = _reading_rows(joints, fine.t - fine.knots[knot], solution.system.states)
    moved = np.zeros((*fine.values.shape, len(fine.columns)))
    for c, column in enumerate(fine.columns):
        moved[..., c] = column.reads(fine.t, solution.linear.path)
    mean, *parts = beliefs.split_rows(rows, knot, moved)
    own, by_sizes = (np.einsum("nmm->nm", one) for one in parts)
    if fine.settled is None:
        return mean, own + by_sizes, np.zeros_like(own)
    return mean, own, by_sizes


def _at_instants(
    problem: FilterProblem, fine: FactorProblem, solution: Solution, causal: bool
) -> Instants:
    """The beliefs at the instants of the log's timeline."""
    t = problem.timeline.t
    noise = solution.linear.noise
    joints = noise.joints
    m = len(problem.start)
    p = joints.states
    knot = np.clip(np.searchsorted(fine.knots, t + 1e-9) - 1, 0, len(fine.knots) - 1)
    ahead = t - fine.knots[knot]
    size = solution.system.states
    stands = np.zeros((len(t), m, size))
    rows = joints.stands(ahead)
    for j in range(m):
        stands[:, j, j * p : (j + 1) * p] = rows[:, j]
    path = path_of(fine, noise, solution.beliefs)
    bends = np.zeros((len(t), m, len(fine.columns)))
    for c, column in enumerate(fine.columns):
        if column.bends:
            bends[..., c] = column.moves_links(path)[knot]
    angles, cov = solution.beliefs.of_rows(stands, knot, bends)
    state = solution.beliefs.mean[:, : m * p].reshape(-1, m, p)
    rates = state[knot, :, 1] + ahead[:, None] * state[knot, :, 2]
    offsets = np.zeros((len(t), m))
    if joints.error is not None:
        offsets = np.where(joints.learned, 0.0, state[knot, :, -1])
    forward = filtered(solution.system, solution.eliminated)
    at_knot = np.abs(ahead) <= 1e-9
    nats = np.zeros(len(t))
    rows = np.flatnonzero(at_knot)
    knots_there, first = np.unique(knot[rows], return_index=True)  # instants may share a knot
    nats[rows[first]] = np.diff(np.asarray(forward.nats), prepend=0.0)[knots_there]
    early = predicted(solution.system, solution.eliminated) if causal else solution.beliefs
    before, before_cov = early.of_rows(stands, knot, bends)
    errors = _encoder_errors(problem, fine, solution, early, causal)
    return Instants(angles, rates, offsets, cov, nats, before, before_cov, errors)


def _places(
    problem: FilterProblem, instants: Instants, solution: Solution, number: int, causal: bool
) -> tuple[Array, Array, Array]:
    """Where a sense's images were expected: mean (F,D),
    covariance (F,D,D), the model's variance (F,D).
    """
    linear = solution.linear
    images = linear.problem.images[number]
    rows = linear.rows[number]
    sighting = images.sighting
    names = [one.name for one in problem.evidence.sightings]
    at = problem.timeline.sightings[names.index(sighting.name)]
    mean, jac, var = sighting.model.predict(instants.before[at])
    cov = jac @ instants.before_cov[at] @ jac.swapaxes(1, 2)
    beliefs = predicted(solution.system, solution.eliminated) if causal else solution.beliefs
    expected, own, settled = _expect_images(linear.problem, images, rows, beliefs)
    residual = rows.right[..., 0] - expected
    spread = own + settled
    if not causal:
        var_used = linear.noise.scales[number] * rows.var / images.believed[:, None]
        noise = var_used[..., None] * np.eye(residual.shape[1])
        residual, left = left_out(residual, noise, own, settled)
        spread = left - noise
    # the model's error is among the states
    seen = unmix_rows(images.mix, (images.values - residual, spread, np.zeros(residual.shape)))
    mean = mean.copy()
    cov = cov.copy()
    var = np.array(var)
    mean[images.frames], cov[images.frames], var[images.frames] = seen
    return mean, cov, var


def _encoder_errors(
    problem: FilterProblem, fine: FactorProblem, solution: Solution, early: Marginals, causal: bool
) -> Array:
    """Errors (E,M) of readings in standard deviations, by
    what came before or by the rest of the log; NaN elsewhere.
    """
    line = problem.timeline
    joints = solution.linear.noise.joints
    found = np.full((len(line.t), len(problem.start)), np.nan)
    knot = np.clip(np.searchsorted(fine.knots, fine.t + 1e-9) - 1, 0, len(fine.knots) - 1)
    ahead = fine.t - fine.knots[knot]
    mean, own, settled = _expect_readings(fine, solution, early, knot)
    var = joints.white * fine.relative
    assert fine.believed is not None
    rest = np.maximum(var / fine.believed - own, 1e-3 * var)
    total = (var + own if causal else rest) + settled
    at_knot = ahead <= 1e-9
    found[line.encoders[at_knot]] = ((fine.values - mean) / np.sqrt(total))[at_knot]
    return found
