"""A log that its hardware's errors explain: posed
as factors, explained, and solved at every instant.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...kinematics.calibration import CHI_SQUARE_MEDIANS
from ...types import Array
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS, PRIOR_STD_RAD
from ..inference.filter_problem import FilterProblem
from ..inference.tangents import OFFSET_STD
from ..measurements.long_arrays import find_finite_rows, measure_median_step
from ..measurements.records import Encoders, unmix_rows
from .columns import EncoderShift
from .condensing import SAME_TIME_S
from .elimination import Marginals, filter_knots, predict_knots
from .encoder_error import LEAST_STD, MOTION_ORDER, JointNoise
from .factor_problem import FactorProblem, LastingPrior, Noise
from .gauss_newton import Solution, path_from_beliefs, solve_problem
from .hypotheses import (
    Explanation,
    add_lasting_errors,
    conclude_white_noise,
    find_explanation,
    fit_white_noise,
)
from .images import ImageRows, Images, find_nearest_knots
from .load import WIDE_BEND, LoadColumns, count_groups
from .robust import (
    compute_believed_shares,
    compute_outlier_nats,
    leave_out_measurement,
    measure_image_span,
)
from .timed_columns import list_timed_loads

CLOSEST_S = 4e-3
"""s: instants closer than this share a knot, because the
information of motion grows with the fifth power of a step.
"""
COARSE_S = 0.01
"""s between the knots that noise is learned on, at least:
images, and instants where there are none for long.
"""
WEIGHING_ROUNDS = 3
"""Rounds of linearising before readings are weighed."""
SPARSE_S = 0.1
"""s between the knots that noise is learned on where no images are."""
LEARNED_S = 60.0
"""s of a log that noise is learned from; longer ones give their middle."""
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
        return replace(self, explanation=conclude_white_noise(self.fine, self.explanation.white))


@dataclass(frozen=True, eq=False)
class SolvedLog:
    """Beliefs at the instants, and places {sense}: where its images were expected.

    A place has mean (F,D), covariance (F,D,D) and the model's variance (F,D), by what came earlier
    or by the rest of the log, without the image's own noise.
    """

    instants: Instants
    places: Mapping[str, tuple[Array, Array, Array]]


def explain_log(
    problem: FilterProblem, halves: Array, lasting: LastingPrior, loads: tuple[LoadColumns, ...]
) -> ExplainedLog | None:
    """Explain a log by white noise alone, or by errors of
    its hardware; None where it has no readings or no images.

    problem: with the encoder offsets that were found · halves (M,) rad: half of each joint's play
    in the exploration · lasting: errors of encoders before the log · loads: of which one may be
    carried, as of `build_load_columns`.
    """
    posed = _pose_log(problem)
    if posed is None:
        return None
    fine, coarse, noise = posed
    encoders = _require_encoders(problem)
    found = find_explanation(
        coarse,
        replace(noise, prior=lasting),
        measure_median_step(encoders.t),
        encoders.count_variance,
        halves,
        loads,
    )
    return ExplainedLog(fine, found, found.learned.nats + _weigh_outliers(coarse))


def explain_by_white_noise(problem: FilterProblem) -> ExplainedLog | None:
    """Explain a log by white noise alone; None where it has no readings or no images."""
    posed = _pose_log(problem)
    if posed is None:
        return None
    fine, coarse, noise = posed
    white = fit_white_noise(coarse, noise, measure_median_step(_require_encoders(problem).t))
    explanation = conclude_white_noise(fine, white)
    return ExplainedLog(fine, explanation, white.nats + _weigh_outliers(coarse))


def _require_encoders(problem: FilterProblem) -> Encoders:
    """The encoders of a log that is posed: it has some."""
    assert problem.evidence.encoders is not None
    return problem.evidence.encoders


def resembles_load(
    problem: FilterProblem, without: FilterProblem, loads: tuple[LoadColumns, ...]
) -> bool:
    """Whether white noise and one of the loads explain a log about as well as white noise and
    encoder offsets, compared without learning, which takes ten times as long. In simulation, drifts
    won by 130 nats and more, joints homed differently by 17 and 22, and payloads lost by 40 and 66.

    problem, without: with the encoder offsets that were found, and without.
    """
    posed = _pose_log(problem)
    alone = _pose_log(without)
    if posed is None or alone is None:
        return False
    _, shifted, its_noise = posed
    found = solve_problem(shifted, its_noise, rounds=WEIGHING_ROUNDS)
    offset = found.nats + _weigh_outliers(shifted)
    _, coarse, noise = alone
    beliefs = solve_problem(coarse, noise, rounds=WEIGHING_ROUNDS).beliefs
    path = path_from_beliefs(coarse, noise, beliefs)
    outliers = _weigh_outliers(coarse)
    for load in loads:
        wide = replace(noise, groups=(WIDE_BEND,) * count_groups(load))
        for one, cost in list_timed_loads(coarse, noise, path, load):
            bent = solve_problem(coarse.with_columns(one), wide, path, rounds=WEIGHING_ROUNDS)
            if bent.nats + outliers + cost - offset < EVIDENCE_THRESHOLD_NATS:
                return True
    return False


def _pose_log(problem: FilterProblem) -> tuple[FactorProblem, FactorProblem, Noise] | None:
    """The log on fine and on coarse knots, its readings and images
    weighed, and its first noise; None without readings or images.
    """
    encoders = problem.evidence.encoders
    sightings = tuple(
        one for one in problem.evidence.sightings if find_finite_rows(one.values).any()
    )
    if encoders is None or not sightings or not np.isfinite(encoders.values).any():
        return None
    fine = FactorProblem(
        _thin_times(problem.timeline.t, CLOSEST_S),
        encoders.t,
        encoders.values,
        encoders.relative_variance,
        problem.start,
        sightings,
        tuple(_list_repaired_steps(problem)),
    )
    noise = _guess_noise(problem, len(sightings))
    # a joint that rests may bend, too
    lasting = add_lasting_errors(replace(noise, resting=None), USUAL_STD)
    fine = _weigh_measurements(fine, lasting, rough=True)
    return fine, _coarsen_middle(fine), noise


def solve_log(problem: FilterProblem, found: ExplainedLog, causal: bool) -> SolvedLog:
    """The beliefs at each instant by what came before (causal) or by the whole log."""
    fine = replace(found.explanation.settle_columns(found.fine), nearest=not causal)
    fine = _weigh_measurements(fine, found.noise, rough=False)
    solution = solve_problem(fine, found.noise, causal=causal)
    early = solution.beliefs
    if causal:
        early = predict_knots(solution.system, solution.eliminated)
    instants = _evaluate_instants(problem, fine, solution, early, causal)
    places = {
        name: _expect_places(problem, instants, solution, early, number, causal)
        for number, name in enumerate(found.senses)
    }
    return SolvedLog(instants, places)


def _weigh_outliers(problem: FactorProblem) -> float:
    """−ln p of readings and images as far as they are outliers."""
    assert problem.believed is not None and problem.images_believed is not None
    known = np.isfinite(problem.values)
    total = compute_outlier_nats(problem.believed[known], TURN)
    for one, share in zip(problem.sightings, problem.images_believed, strict=True):
        seen = find_finite_rows(one.values)
        span = measure_image_span(one.values[seen], one.var[seen])
        total += compute_outlier_nats(share[seen], span)
    return total


def _list_repaired_steps(problem: FilterProblem) -> Iterator[EncoderShift]:
    """Steps that were taken out of readings: what is left of each is known to its standard
    deviation. Those that images show are sized by them again, beside what explains the log.
    """
    names = problem.evidence.joints
    for fault in problem.evidence.faults:
        joint = fault.names[0]
        if fault.sense == "encoders" and fault.std is not None and joint in names:
            number = names.index(joint)
            std = max(fault.std, OFFSET_STD) if number in problem.alternatives else fault.std
            yield EncoderShift(
                "repaired step", std, joint=number, since=fault.since, until=fault.end
            )


def _thin_times(t: Array, least: float) -> Array:
    """Times (K,) of t (E,) s that are at least so far apart."""
    kept = []
    last = -np.inf
    for one in t.tolist():
        if one - last >= least:
            kept.append(one)
            last = one
    return np.array(kept)


def _coarsen_middle(fine: FactorProblem) -> FactorProblem:
    """The log, or its middle, on knots at its images."""
    centre = 0.5 * (fine.knots[0] + fine.knots[-1])
    begin = centre - LEARNED_S / 2
    end = centre + LEARNED_S / 2
    seen = [one.t[find_finite_rows(one.values)] for one in fine.sightings]
    images = np.sort(np.concatenate(seen))
    spread = np.arange(fine.knots[0], fine.knots[-1], SPARSE_S)
    alone = np.abs(spread - images[find_nearest_knots(spread, images)]) > SPARSE_S
    ends = [fine.knots[0], fine.knots[-1]]
    t = np.unique(np.concatenate([images, spread[alone], ends]))
    knots = _thin_times(t[(t >= begin) & (t <= end)], COARSE_S)
    rows = (fine.t >= knots[0] - SAME_TIME_S) & (fine.t <= knots[-1] + SAME_TIME_S)
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


def _guess_noise(problem: FilterProblem, sights: int) -> Noise:
    """White noise with which the search begins; a joint whose offset was found has it as a walk of
    its encoder: what is left of it where it was taken out of the readings, or all of it.
    """
    precision = problem.precision
    m = len(problem.start)
    process = np.full(m, FIRST_PROCESS)
    if precision.learned is not None:
        process = np.clip(precision.learned[MOTION_ORDER - 2].process, 1e-2, 1e3)
    drift = np.zeros(m) if precision.drift is None else precision.drift
    walks = drift > 0.0
    far = np.full(m, PRIOR_STD_RAD)
    far[[step.joint for step in _list_repaired_steps(problem)]] = OFFSET_STD
    # where no error lasts, any τ leaves the problem what it is
    seconds = np.where(walks, 2.0 * far**2 / np.where(walks, drift, 1.0), 1.0)
    error = np.where(walks, far, LEAST_STD) if walks.any() else None
    joints = JointNoise(
        precision.encoder, process, error, seconds, np.zeros(m, bool), np.zeros(m, bool)
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
    encoders = _require_encoders(problem)
    rest = measure_turns(encoders) < REST_SIGMAS * np.sqrt(problem.precision.encoder)
    return np.asarray(rest & ~rest.all())


def _weigh_measurements(fine: FactorProblem, noise: Noise, rough: bool) -> FactorProblem:
    """The problem with the share that is believed of each reading and image.

    rough: before the noise is known, images are judged by what most of them are off.
    """
    open_problem = replace(fine, believed=None, images_believed=None)
    solution = solve_problem(open_problem, noise, rounds=WEIGHING_ROUNDS)
    fine = _update_shares(fine, solution, noise, rough)
    # an outlier no longer hides another, nor a sound reading
    path = path_from_beliefs(fine, noise, solution.beliefs)
    solution = solve_problem(fine, noise, path, rounds=WEIGHING_ROUNDS)
    return _update_shares(fine, solution, noise, rough)


def _update_shares(
    fine: FactorProblem, solution: Solution, noise: Noise, rough: bool
) -> FactorProblem:
    """The problem with shares by what the rest of the log predicts."""
    beliefs = solution.beliefs
    knots = find_nearest_knots(fine.t, fine.knots)
    mean, own, settled = _expect_readings(fine, solution, beliefs, knots)
    share = np.ones(fine.values.shape)
    used = solution.linear.problem.believed
    for j in range(len(fine.start)):
        known = np.isfinite(fine.values[:, j])
        var = (noise.joints.white[j] * fine.relative[known, j])[:, None, None]
        weighed = var if used is None else var / used[known, j][:, None, None]
        residual = (fine.values[known, j] - mean[known, j])[:, None]
        parts = (one[known, j][:, None, None] for one in (own, settled))
        rest, spread = leave_out_measurement(residual, weighed, *parts)
        # what the others predict, and this one's own noise if it is sound
        spread = spread - weighed + var
        share[known, j] = compute_believed_shares(rest, np.maximum(spread, var), TURN)
    shares: list[Array] = []
    for images, linear in zip(solution.linear.problem.images, solution.linear.rows, strict=True):
        scale = noise.scales[len(shares)]
        expected = _expect_rows(fine, beliefs, linear.slopes, images.knots, linear.right[..., 1:])
        shares.append(_compute_image_shares(images, linear, expected, scale, rough))
    return replace(fine, believed=share, images_believed=tuple(shares))


def _expect_rows(
    problem: FactorProblem, beliefs: Marginals, rows: Array, knots: Array, columns: Array
) -> tuple[Array, Array, Array]:
    """What is believed of rows (F,D,S) on the states at knots (F,), and of columns (F,D,C): mean
    (F,D), covariance (F,D,D) by what measurements change, and by sizes of columns that are settled.
    """
    mean, own, by_sizes = beliefs.split_rows(rows, knots, columns)
    if problem.settled is None:
        return mean, own + by_sizes, np.zeros_like(own)
    return mean, own, by_sizes


def _compute_image_shares(
    images: Images, rows: ImageRows, expected: tuple[Array, Array, Array], scale: float, rough: bool
) -> Array:
    """Shares (N,) of a sense's images, which are expected as of `_expect_rows`."""
    mean, cov, settled = expected
    one = np.eye(mean.shape[1])
    plain = (scale * rows.var)[..., None] * one
    used = plain / images.believed[:, None, None]
    rest, spread = leave_out_measurement(rows.right[..., 0] - mean, used, cov, settled)
    spread = spread - used + plain
    if rough:
        square = np.einsum("fd,fd->f", rest, np.linalg.solve(spread, rest[..., None])[..., 0])
        usual = CHI_SQUARE_MEDIANS[min(mean.shape[1], max(CHI_SQUARE_MEDIANS))]
        spread = spread * max(1.0, float(np.median(square)) / usual)
    span = measure_image_span(images.values, rows.var)
    share = np.ones(len(images.sighting.t))
    share[images.frames] = compute_believed_shares(rest, spread, span)
    return share


def _expect_readings(
    fine: FactorProblem, solution: Solution, beliefs: Marginals, knots: Array
) -> tuple[Array, Array, Array]:
    """Expected readings from the beliefs at a knot (N,) close to each, columns included: mean
    (N,M), variance (N,M) by the states, and by the sizes of columns that are settled.
    """
    joints = solution.linear.noise.joints
    rows = joints.build_reading_rows(fine.t - fine.knots[knots])
    rows = joints.place_rows_on_knots(rows, solution.system.state_count)
    moved = np.zeros((*fine.values.shape, len(fine.columns)))
    for c, column in enumerate(fine.columns):
        moved[..., c] = column.changes_readings(fine.t, solution.linear.path)
    mean, own, settled = _expect_rows(fine, beliefs, rows, knots, moved)
    return mean, np.einsum("nmm->nm", own), np.einsum("nmm->nm", settled)


def _find_knots_before(t: Array, knots: Array) -> tuple[Array, Array]:
    """Numbers (N,) of the last knots (K,) s that are not after times t (N,) s, and the seconds (N,)
    from these knots on.
    """
    before = np.clip(np.searchsorted(knots, t + SAME_TIME_S) - 1, 0, len(knots) - 1)
    return before, t - knots[before]


def _evaluate_instants(
    problem: FilterProblem, fine: FactorProblem, solution: Solution, early: Marginals, causal: bool
) -> Instants:
    """The beliefs at the instants of the log's timeline; early: by what came earlier, or by all."""
    t = problem.timeline.t
    noise = solution.linear.noise
    joints = noise.joints
    knot, ahead = _find_knots_before(t, fine.knots)
    rows = joints.place_rows_on_knots(joints.build_link_rows(ahead), solution.system.state_count)
    path = path_from_beliefs(fine, noise, solution.beliefs)
    bends = np.zeros((*rows.shape[:2], len(fine.columns)))
    for c, column in enumerate(fine.columns):
        if column.bends:
            bends[..., c] = column.moves_links(path)[knot]
    angles, cov = solution.beliefs.project_rows(rows, knot, bends)
    state = solution.beliefs.split_joints(joints)
    rates = state[knot, :, 1] + ahead[:, None] * state[knot, :, 2]
    offsets = np.zeros(angles.shape)
    if joints.error is not None:
        offsets = np.where(joints.learned, 0.0, state[knot, :, -1])
    forward = filter_knots(solution.system, solution.eliminated)
    at_knot = np.flatnonzero(np.abs(ahead) <= SAME_TIME_S)
    nats = np.zeros(len(t))
    knots_there, first = np.unique(knot[at_knot], return_index=True)  # instants may share a knot
    nats[at_knot[first]] = np.diff(np.asarray(forward.nats), prepend=0.0)[knots_there]
    before, before_cov = early.project_rows(rows, knot, bends)
    errors = _standardise_readings(problem, fine, solution, early, causal)
    return Instants(angles, rates, offsets, cov, nats, before, before_cov, errors)


def _expect_places(
    problem: FilterProblem,
    instants: Instants,
    solution: Solution,
    early: Marginals,
    number: int,
    causal: bool,
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
    expected, own, settled = _expect_rows(
        linear.problem, early, rows.slopes, images.knots, rows.right[..., 1:]
    )
    residual = rows.right[..., 0] - expected
    spread = own + settled
    if not causal:
        var_used = linear.noise.scales[number] * rows.var / images.believed[:, None]
        noise = var_used[..., None] * np.eye(residual.shape[1])
        residual, left = leave_out_measurement(residual, noise, own, settled)
        spread = left - noise
    # the model's error is among the states
    seen = unmix_rows(images.mix, (images.values - residual, spread, np.zeros(residual.shape)))
    mean = mean.copy()
    cov = cov.copy()
    var = np.array(var)
    mean[images.frames], cov[images.frames], var[images.frames] = seen
    return mean, cov, var


def _standardise_readings(
    problem: FilterProblem, fine: FactorProblem, solution: Solution, early: Marginals, causal: bool
) -> Array:
    """Errors (E,M) of readings in standard deviations, by
    what came before or by the rest of the log; NaN elsewhere.
    """
    joints = solution.linear.noise.joints
    encoder_rows = problem.timeline.encoders
    knot, ahead = _find_knots_before(fine.t, fine.knots)
    mean, own, settled = _expect_readings(fine, solution, early, knot)
    var = joints.white * fine.relative
    assert fine.believed is not None
    rest = np.maximum(var / fine.believed - own, 1e-3 * var)
    total = (var + own if causal else rest) + settled
    at_knot = np.abs(ahead) <= SAME_TIME_S
    found = np.full((len(problem.timeline.t), len(problem.start)), np.nan)
    found[encoder_rows[at_knot]] = ((fine.values - mean) / np.sqrt(total))[at_knot]
    return found
