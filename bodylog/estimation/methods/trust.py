"""Whether errors of the hardware may be taken out of a log's angles: conditions that need no truth.

An explanation has more freedom than white noise. It is taken where the log shows what it claims,
where its engine gives for white noise what the filter gives, and where images that follow each
other no longer have the same error.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...linear_algebra import project_covariance
from ...motion import WHITE_JERK
from ...settings import EstimationSettings
from ...types import Array
from ..factors.columns import EncoderShift, Play
from ..factors.hypotheses import Explanation
from ..factors.load import bend_under_load
from ..factors.robust import compute_mixture_nats, measure_image_span
from ..factors.whole_log import (
    ExplainedLog,
    SolvedLog,
    explain_by_white_noise,
    find_resting_joints,
    measure_turns,
    solve_log,
)
from ..faults.threshold import SIGNIFICANT_SIGMA
from ..inference.filter_log import filter_roughly, loses_encoder
from ..inference.filter_pass import GATE_SIGMA
from ..inference.filter_problem import FilterProblem
from ..inference.leave_one_out import remove_readings
from ..measurements.arm_errors import LEAST_PLAY, follow_links
from ..measurements.long_arrays import MIN_READINGS, find_finite_rows
from ..measurements.records import Encoders
from ..noise.evidence_search import tune_by_evidence
from ..noise.lasting_error import MOST_COUNTS
from .results import Beliefs, standardise_sighting

LEAST_TURN = 10.0
"""Sizes of the error by which each joint turns at least. An arm that turns less shows the body's
error and the encoders' at few postures, where they are one.
"""
MOST_APART = 1.0
"""Standard deviations by which two solutions with white noise may differ (root mean square): they
use the same measurements, and only their noise and their outliers are found separately. Beside
images of 0.04 px and errors that last, those of 3 of 35 drawn logs differ by more than their own
standard deviations, and the explained logs have NEES of 1.0 to 1.9.
"""
MOST_MISFIT = 2.0
"""Variance of the mean of successive errors over the stated one: true for white ones that have
their stated size, 1; error bars beyond it are wrong.
"""
ROUGH_SIGMAS = 2.5
"""Standard deviations from which errors of encoders and images agree: by chance in 1 log of 160."""
MOST_COLOUR = 0.1
"""Correlation of an encoder's innovations, from one reading to the next or the one after it, from
which a joint does not move as assumed. Of 8 drawn sound logs each joint has at most 0.06, and of 8
in which joints stick and slip by four times the noise, and more, the least is 0.11. In six others
of 16 s each joint has at most 0.052, and in six that slip by four times the noise each log has a
joint of 0.195 and more: with 0.05 one of 18 sound joints is taken for rough, with 0.2 one slipping
log is not.
"""
LEAST_SQUARE = 0.5
"""Mean square of innovations in standard deviations below which error bars are too wide, and not
too small: encoders of a microrad, on joints that turn smoothly, have 0.17 to 0.35. With 1 no log
would be taken for rough: sound and slipping ones have 0.98 to 1.02 (12 of 16 s). With 0.25 some of
a microrad would be.
"""


def find_reason_to_widen(
    problem: FilterProblem, std: float, settings: EstimationSettings
) -> str | None:
    """Why an error of std rad is not looked for in the log; None if it is."""
    if settings.hardware_errors == "widen":
        return 'type hardware_errors = "explain" under [estimate] to have them taken out'
    if settings.motion not in ("auto", WHITE_JERK):
        return f"motion is set to {settings.motion}, and they are looked for under {WHITE_JERK}"
    if settings.bias != "auto":
        return f"encoder offsets are set to {settings.bias}"
    if settings.typed:
        return "variances are set"
    if problem.stepwise or problem.evidence.encoders is None:
        return "encoders are silent for long"
    turns = measure_turns(problem.evidence.encoders)
    still = (turns < LEAST_TURN * std) & ~find_resting_joints(problem)
    for j in np.flatnonzero(still).tolist():
        turn = f"{problem.evidence.joints[j]} turns by {turns[j]:.2g} rad"
        return f"{turn}, too little to tell them from the body's error"
    return None


def find_reason_of_disagreement(
    problem: FilterProblem,
    beliefs: Beliefs,
    found: ExplainedLog,
    explained: SolvedLog,
    causal: bool,
) -> str | None:
    """Why the solution with white noise is not that of the beliefs; None if it is, to what these
    or the explained log say of their own errors, whichever is more.

    Where play, a load or what is left of an encoder's step explains the log, white noise blames
    images or encoders for it, each engine others. So both filter that log again, from readings of
    the links.
    """
    if any(one.bends or isinstance(one, EncoderShift) for one in found.explanation.columns):
        problem = _move_readings_to_links(problem, found.explanation)
        problem = replace(problem, precision=tune_by_evidence(problem, whole=False)[0])
        filtered = filter_roughly(problem)
        angles = filtered.trace.z
        cov = filtered.trace.cov
        white = explain_by_white_noise(problem)
        assert white is not None  # as the log with its load has an explanation
        causal = True
    else:
        angles = beliefs.z
        cov = beliefs.cov
        white = found.with_white_noise()
    m = len(problem.start)
    solved = solve_log(problem, white, causal)
    each = (cov[:, :m, :m], explained.instants.cov)
    stated = np.maximum(*(np.einsum("emm->em", one) for one in each))
    apart = solved.instants.angles - angles[:, :m]
    # of joints that rest, each engine assumes another least motion
    turning = ~find_resting_joints(problem)
    far = float(np.sqrt(np.mean((np.square(apart) / stated)[:, turning])))
    if far <= MOST_APART:
        return None
    return f"two solutions for white noise are {far:.2g} standard deviations apart"


def _move_readings_to_links(problem: FilterProblem, explanation: Explanation) -> FilterProblem:
    """The problem with readings of the links, which lie in the play that explains the log, and bend
    under the load, without what is left of the steps that were taken out of them.
    """
    names = problem.evidence.joints
    sizes = list(zip(explanation.columns, explanation.learned.sizes.tolist(), strict=True))
    play = {
        names[column.joint]: (2.0 * size, 0.0)
        for column, size in sizes
        if isinstance(column, Play) and size > LEAST_PLAY
    }

    def bend_with_load(t: Array, angles: Array) -> Array:
        return angles + bend_under_load(explanation.columns, explanation.learned.sizes, t, angles)

    encoders = problem.evidence.encoders
    assert encoders is not None  # of what is explained
    path = explanation.learned.path
    left = (
        size * column.changes_readings(encoders.t, path)
        for column, size in sizes
        if isinstance(column, EncoderShift)
    )
    motors = encoders.values - sum(left, np.zeros(encoders.values.shape))
    links = follow_links(encoders.t, motors, names, play)
    read = replace(encoders, values=bend_with_load(encoders.t, links))
    evidence = replace(problem.evidence, encoders=read)
    return replace(
        problem,
        evidence=evidence,
        start=bend_with_load(problem.timeline.t[:1], problem.start[None])[0],
    )


def find_reason_of_misfit(
    problem: FilterProblem, found: ExplainedLog, solved: SolvedLog, causal: bool
) -> str | None:
    """Why the explained log is not to be trusted by what it leaves unexplained; None if it is."""
    if not (np.isfinite(solved.instants.angles).all() and np.isfinite(solved.instants.cov).all()):
        return "their explanation gives no finite angles"
    earlier = solved if causal else solve_log(problem, found, causal=True)
    for name, misfit in _measure_misfits(problem, found, earlier):
        if not misfit <= MOST_MISFIT:
            return f"errors of successive images of {name} still correlate (misfit {misfit:.2g})"
    return None


@dataclass(frozen=True, eq=False)
class RoughMotion:
    """What joints do beside the motion that is assumed: its
    variance (M,) rad² · nats of each image by the readings and images before it, at the instants
    at · nats of all measurements at each instant (E,).
    """

    variance: Array
    image_nats: Array
    at: Array
    nats: Array


def measure_rough_motion(
    problem: FilterProblem, beliefs: Beliefs, causal: bool
) -> RoughMotion | None:
    """What joints do beside the motion that is assumed; None where a log shows no such thing.

    Where a filter's innovations are not white, all noise of readings may be motion; images show
    what part of it is. A smoother's log is filtered here: causal is whether problem and beliefs are
    those of a filter.
    """
    encoders = problem.evidence.encoders
    if encoders is None or problem.stepwise:
        return None
    x = beliefs.before
    cov = beliefs.before_cov
    read = beliefs.encoder_errors
    nats = beliefs.nats
    if not causal and problem.precision.filter_process is not None:
        # a smoother's own process is smaller:
        # a filter with it lags, and its innovations have colour
        process = problem.precision.filter_process
        problem = replace(problem, precision=replace(problem.precision, process=process))
    if not causal:
        problem = replace(problem, path=(problem.timeline.t, x))
        solution = filter_roughly(problem, rest=1.0)
        if loses_encoder(problem, solution):
            # readings that hindsight contradicts made it lose the joint: that is no motion
            far = np.abs(read[problem.timeline.encoders]) > GATE_SIGMA
            kept = (np.zeros(len(one.t), bool) for one in problem.evidence.sightings)
            problem = remove_readings(problem, (far, *kept))
            solution = filter_roughly(problem, rest=1.0)
        trace = solution.trace
        x = trace.prior
        cov = trace.prior_cov
        read = trace.encoder_d
        nats = trace.nats
    products, weights, image_nats, at = _compare_images_with_readings(problem, x, cov, read)
    noise = problem.precision.encoder
    coloured = _find_coloured_joints(read[problem.timeline.encoders], encoders, noise)
    variance = np.maximum(np.where(coloured, noise, 0.0), _measure_shared_motion(products, weights))
    if not variance.any():
        return None
    return RoughMotion(variance, image_nats, at, nats)


def _compare_images_with_readings(
    problem: FilterProblem, x: Array, cov: Array, read: Array
) -> tuple[Array, Array, Array, Array]:
    """What each image that has a reading before it says of motion that is not assumed: the product
    (F,M) of the slope of its nats by the angle, 1/rad, and the error of the reading before it, rad;
    the weight (F,M) of a variance in the product, 1/rad²; its nats (F,) by the readings and images
    before it; and its instant (F,).

    x (E,M) and cov (E,M,M): what a filter expects at each instant · read (E,M): the errors of
    readings from it, in standard deviations.
    """
    line = problem.timeline
    noise = problem.precision.encoder
    joints = len(problem.start)
    found = [(np.zeros((0, joints)), np.zeros((0, joints)), np.zeros(0), np.zeros(0, int))]
    for sighting, at in zip(problem.evidence.sightings, line.sightings, strict=True):
        if sighting.name == "touch" or sighting.cov is not None:
            continue
        before = np.searchsorted(line.encoders, at) - 1
        usable = (before >= 0) & find_finite_rows(sighting.values)
        rows = at[usable]
        earlier = line.encoders[before[usable]]
        seen = sighting.values[usable]
        var = problem.precision.scale.get(sighting.name, 1.0) * sighting.var[usable]
        mean, jac, model_var = sighting.model.predict(x[rows])
        size = np.einsum("fdd->fd", project_covariance(jac, cov[rows])) + model_var + var
        off = np.clip((seen - mean) / np.sqrt(size), -SIGNIFICANT_SIGMA, SIGNIFICANT_SIGMA)
        stated = np.sqrt(noise + np.einsum("fmm->fm", cov[earlier]))
        pull = np.einsum("fdm,fd->fm", jac, off / np.sqrt(size))
        product = pull * stated * np.clip(read[earlier], -SIGNIFICANT_SIGMA, SIGNIFICANT_SIGMA)
        weight = np.einsum("fdm,fd->fm", np.square(jac), 1.0 / size)
        there, near = _weigh_readings_there(x[rows], cov[rows], read[rows], noise)
        mean, jac, model_var = sighting.model.predict(there)
        total = project_covariance(jac, near)
        np.einsum("fdd->fd", total)[:] += model_var + var
        nats = compute_mixture_nats(
            seen - mean, total, measure_image_span(seen, sighting.var[usable])
        )
        found.append((product, weight, nats, rows))
    product, weight, nats, rows = map(np.concatenate, zip(*found, strict=True))
    known = find_finite_rows(product)
    return product[known], weight[known], nats[known], rows[known]


def _measure_shared_motion(products: Array, weights: Array) -> Array:
    """Variance (M,) rad² that errors of images share with those of readings, zero where the log
    shows none.

    The errors of an image and of the reading before it are independent. Where both lie on the same
    side of what a filter expects of earlier ones, the joint itself was there: it sticks and slips.
    """
    alike = products.sum() >= ROUGH_SIGMAS * np.sqrt(np.square(products).sum())
    if len(products) < MIN_READINGS or not alike:
        return np.zeros(products.shape[1])
    weight = weights.sum(axis=0)
    shown = np.isfinite(weight) & (weight > 0.0)
    shared = np.maximum(products.sum(axis=0), 0.0)
    return np.asarray(np.divide(shared, weight, out=np.zeros(len(weight)), where=shown))


def _find_coloured_joints(errors: Array, encoders: Encoders, noise: Array) -> Array:
    """Joints (M,) bool whose innovations (N,M), in standard deviations, are not white. Those
    whose noise is that of whole counts have none that are.
    """
    cut = np.clip(errors, -SIGNIFICANT_SIGMA, SIGNIFICANT_SIGMA)
    found = np.zeros(len(noise), bool)
    of_counts = noise <= MOST_COUNTS * encoders.count_variance
    for j, column in enumerate(cut.T):
        read = column[np.isfinite(column)]
        # a correlation of n readings is known to 1/√n
        if of_counts[j] or len(read) * MOST_COLOUR**2 < SIGNIFICANT_SIGMA**2:
            continue
        square = float(np.mean(np.square(read)))
        if square < LEAST_SQUARE:
            continue
        for lag in (1, 2):
            product = read[lag:] * read[:-lag]
            found[j] |= abs(float(np.mean(product))) > MOST_COLOUR * square
    return found


def _weigh_readings_there(x: Array, cov: Array, read: Array, noise: Array) -> tuple[Array, Array]:
    """Angles (F,M) and their covariances (F,M,M) with the readings of the same
    instant, of errors read (F,M) in standard deviations, NaN where there are none.
    """
    known = np.isfinite(read)
    spread = np.sqrt(np.einsum("fmm->fm", cov) + noise)
    total = cov + np.where(known, noise, 1e6)[..., None] * np.eye(len(noise))
    gain = np.linalg.solve(total, cov).swapaxes(1, 2)
    off = np.where(known, read, 0.0) * spread
    return x + (gain @ off[..., None])[..., 0], cov - gain @ cov


def _measure_misfits(
    problem: FilterProblem, found: ExplainedLog, earlier: SolvedLog
) -> Iterator[tuple[str, float]]:
    """Yield each sense and the variance of the mean of its
    successive errors over the stated one, by what came earlier.

    With the mean square s and the correlation r of an error with the next, the mean of many has
    s (1 + r) / (1 − r) times the variance that white errors of variance 1 give it.
    """
    scales = dict(zip(found.senses, found.noise.scales, strict=True))
    for sighting in problem.evidence.sightings:
        if sighting.name not in earlier.places:
            continue
        place = earlier.places[sighting.name]
        series, _, _ = standardise_sighting(sighting, place, scales[sighting.name])
        if len(series.t) < MIN_READINGS:
            continue
        error = np.clip(series.values, -SIGNIFICANT_SIGMA, SIGNIFICANT_SIGMA)
        square = float(np.mean(np.square(error)))
        correlation = float(np.mean(error[1:] * error[:-1])) / square
        yield sighting.name, square * (1.0 + correlation) / max(1.0 - correlation, 1e-9)
