"""Whether errors of the hardware may be taken out of a log's angles: conditions that need no truth.

An explanation has more freedom than white noise. It is taken where the log shows what it claims,
where its engine gives for white noise what the filter gives, and where images that follow each
other no longer have the same error.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...settings import EstimationSettings
from ...types import Array
from ..factors.robust import image_span, mixture_nats
from ..factors.whole_log import ExplainedLog, SolvedLog, solve_log
from ..inference.leave_one_out import project_covariance
from ..inference.problem import FilterProblem
from ..inference.walk import filter_roughly
from ..noise.evidence_search import tune_by_evidence
from .results import Beliefs, standardise_sighting

LEAST_TURN = 10.0
"""Sizes of the error by which each joint turns at least. An arm that turns less shows the body's
error and the encoders' at few postures, where they are one.
"""
MOST_APART = 1.0
"""Standard deviations by which two solutions with white noise may differ (root mean square): they
use the same measurements, and only their noise and their outliers are found separately.
"""
MOST_MISFIT = 2.0
"""Variance of the mean of successive errors over the stated one: true for white ones that have
their stated size, 1; error bars beyond it are wrong.
"""
ROUGH_SIGMAS = 2.5
"""Standard deviations from which errors of encoders and images are alike: by chance in 1 log of 160."""
FEWEST_IMAGES = 24
FAR_SIGMAS = 3.0
"""Standard deviations to which errors are cut: images of something else say nothing here."""


def reason_to_widen(
    problem: FilterProblem, names: tuple[str, ...], std: float, settings: EstimationSettings
) -> str | None:
    """Why an error of std rad is not looked for in the log of these joints; None if it is."""
    if settings.hardware_errors == "widen":
        return 'type hardware_errors = "explain" under [estimate] to have them taken out'
    if settings.bias != "auto":
        return f"encoder offsets are set to {settings.bias}"
    if settings.typed:
        return "variances are set"
    if problem.stepwise or problem.evidence.encoders is None:
        return "encoders are silent for long"
    for name, column in zip(names, problem.evidence.encoders.values.T, strict=True):
        known = column[np.isfinite(column)]
        turn = float(np.ptp(np.quantile(known, [0.05, 0.95]))) if len(known) else 0.0
        if turn < LEAST_TURN * std:
            return f"{name} turns by {turn:.2g} rad, too little to tell them from the body's error"
    return None


def reason_of_disagreement(
    problem: FilterProblem, beliefs: Beliefs, found: ExplainedLog, causal: bool
) -> str | None:
    """Why the solution with white noise is not that of the beliefs; None if it is."""
    white = solve_log(problem, found.with_white_noise(), causal)
    stated = np.einsum("emm->em", beliefs.cov)
    apart = white.instants.angles - beliefs.z[:, : stated.shape[1]]
    far = float(np.sqrt(np.mean(np.square(apart) / stated)))
    if far <= MOST_APART:
        return None
    return f"two solutions for white noise are {far:.2g} standard deviations apart"


def reason_of_misfit(
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
    variance (M,) rad² · nats of each image by the readings
    and images before it, at the instants at.
    """

    variance: Array
    nats: Array
    at: Array


def measure_rough_motion(problem: FilterProblem, causal: bool) -> RoughMotion | None:
    """What joints do beside the motion that is assumed;
    None where a log shows no such thing.

    The errors of an image and of the reading before it are independent. Where both lie on the same
    side of what a filter expects of earlier ones, the joint itself was there: it sticks and slips.
    causal: whether the problem's noise is that of a filter.
    """
    encoders = problem.evidence.encoders
    if encoders is None or problem.stepwise:
        return None
    if not causal:  # a smoother's process is smaller
        problem = replace(problem, precision=tune_by_evidence(problem, whole=False)[0])
    solution = filter_roughly(problem)
    unfold = solution.fold.unfold
    x, cov, read = map(
        unfold, (solution.trace.prior, solution.trace.prior_cov, solution.trace.encoder_d)
    )
    line = problem.timeline
    noise = problem.precision.encoder
    products = []
    weights = []
    nats = []
    instants = []
    for sighting, at in zip(problem.evidence.sightings, line.sightings, strict=True):
        if sighting.name == "touch" or sighting.cov is not None:
            continue
        before = np.searchsorted(line.encoders, at) - 1
        usable = (before >= 0) & np.isfinite(sighting.values).all(axis=1)
        rows = at[usable]
        earlier = line.encoders[before[usable]]
        mean, jac, var = sighting.model.predict(x[rows])
        scale = problem.precision.scale.get(sighting.name, 1.0)
        spread = project_covariance(jac, cov[rows])
        size = np.einsum("fdd->fd", spread) + var + scale * sighting.var[usable]
        away = sighting.values[usable] - mean
        there, near = _with_readings_there(x[rows], cov[rows], read[rows], noise)
        mean_there, jac_there, _ = sighting.model.predict(there)
        total = project_covariance(jac_there, near)
        np.einsum("fdd->fd", total)[:] += var + scale * sighting.var[usable]
        seen = sighting.values[usable]
        span = image_span(seen, sighting.var[usable])
        nats.append(mixture_nats(seen - mean_there, total, span))
        instants.append(rows)
        off = np.clip(away / np.sqrt(size), -FAR_SIGMAS, FAR_SIGMAS)
        own = np.sqrt(noise + np.einsum("fmm->fm", cov[earlier]))
        pull = np.einsum("fdm,fd->fm", jac, off / np.sqrt(size))
        products.append(pull * own * np.clip(read[earlier], -FAR_SIGMAS, FAR_SIGMAS))
        weights.append(np.einsum("fdm,fd->fm", np.square(jac), 1.0 / size))
    both = np.concatenate(products) if products else np.zeros((0, len(problem.start)))
    known = np.isfinite(both).all(axis=1)
    both = both[known]
    if len(both) < FEWEST_IMAGES or both.sum() < ROUGH_SIGMAS * np.sqrt(np.square(both).sum()):
        return None
    weight = np.concatenate(weights)[known].sum(axis=0)
    shown = np.isfinite(weight) & (weight > 0.0)
    shared = np.maximum(both.sum(axis=0), 0.0)
    variance = np.divide(shared, weight, out=np.zeros(len(weight)), where=shown)
    return RoughMotion(variance, np.concatenate(nats)[known], np.concatenate(instants)[known])


def _with_readings_there(x: Array, cov: Array, read: Array, noise: Array) -> tuple[Array, Array]:
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
        if len(series.t) < FEWEST_IMAGES:
            continue
        error = np.clip(series.values, -FAR_SIGMAS, FAR_SIGMAS)
        square = float(np.mean(np.square(error)))
        correlation = float(np.mean(error[1:] * error[:-1])) / square
        yield sighting.name, square * (1.0 + correlation) / max(1.0 - correlation, 1e-9)
