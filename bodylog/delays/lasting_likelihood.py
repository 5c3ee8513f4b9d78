"""Errors of encoders that last through an exploration, by the likelihood of the body's own process.

Where encoders read q + e, residuals r of a track beside what the body expects of the readings are

    r ~ N(0, K + s R + Σₘ σₘ² Jₘ Jₘᵀ ∘ exp(−|Δt| / τ)),

with the process's covariance K, the noise R of its images, the slope Jₘ by joint m, and e an
Ornstein–Uhlenbeck process of standard deviation σₘ and time constant τ. s, σₘ and τ are the most
probable ones; σ = 0 is the alternative.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..estimation.factors.factor_problem import ANY_ERRORS
from ..estimation.factors.noise_search import LOG_SCALE
from ..estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS, SIGNIFICANT_SIGMA
from ..estimation.noise.lasting_error import LONGEST_S
from ..types import Array

TIMES_S = (0.2, 1.0, 4.0)
"""Time constants that are tried first."""
SHORTEST_STEPS = 1.5
"""Steps between residuals that an error outlasts at least: shorter ones are noise of images. Of 16
drawn explorations whose errors last two steps 13 showed them with 2, and all with 1.5; of 66 whose
errors do not last none did, and one with 1.
"""
FIRST_RAD = 1e-3
LEAST_RAD = 1e-5
"""rad: an error that no encoder shows."""
_JITTER = 1e-9


@dataclass(frozen=True, eq=False)
class TrackResiduals:
    """A track beside readings, as R rows: residual (R,), prior,
    noise (R,R) px², slopes (R,M), t (R,) s.
    """

    residual: Array
    prior: Array
    noise: Array
    slopes: Array
    t: Array


def measure_lasting_errors(tracks: Sequence[TrackResiduals]) -> tuple[Array, float, float] | None:
    """σ (M,) rad, τ s of the encoders' errors, and the nats by which they win;
    None if they win too few.
    """
    from scipy.optimize import minimize

    if not tracks:
        return None
    joints = tracks[0].slopes.shape[1]
    none = minimize(_cost, np.zeros(1), (tracks,), jac=True, method="L-BFGS-B")
    scores = [_score_error(tracks, float(np.exp(none.x[0])), seconds) for seconds in TIMES_S]
    if max(scores) < SIGNIFICANT_SIGMA:
        return None
    step = max(float(np.median(np.diff(np.unique(one.t)))) for one in tracks)
    limits = [
        (-10.0, 10.0),
        *[(np.log(0.1 * LEAST_RAD), np.log(0.3))] * joints,
        (np.log(SHORTEST_STEPS * step), np.log(LONGEST_S)),
    ]
    seconds = TIMES_S[int(np.argmax(scores))]
    start = np.array([float(none.x[0]), *[np.log(FIRST_RAD)] * joints, np.log(seconds)])
    found = minimize(
        _cost,
        np.clip(start, *np.transpose(limits)),
        (tracks,),
        jac=True,
        method="L-BFGS-B",
        bounds=limits,
        options={"maxiter": 40, "ftol": 1e-6},
    )
    nats = float(none.fun - found.fun)
    std = np.exp(found.x[1:-1])
    # what lasts no longer than a residual is noise of it
    short = found.x[-1] < limits[-1][0] + 0.01
    if nats <= EVIDENCE_THRESHOLD_NATS or short or std.max() < LEAST_RAD:
        return None
    return std, float(np.exp(found.x[-1])), nats


def lasting_covariance(slopes: Array, t: Array, std: Array, seconds: float) -> Array:
    """Covariance (R,R) of rows at t (R,) s with slopes
    (R,M), by errors of joints of std (M,) rad.
    """
    return np.asarray(
        (slopes * np.square(std)) @ slopes.T * np.exp(-np.abs(t[:, None] - t) / seconds)
    )


def _cost(p: Array, tracks: Sequence[TrackResiduals]) -> tuple[float, Array]:
    """−ln p of all residuals and of the logarithms p of s [, σ (M,), τ], and its gradient."""
    scale = float(np.exp(p[0]))
    total = 0.5 * (p[0] / LOG_SCALE[1]) ** 2
    slope = np.zeros(len(p))
    slope[0] = p[0] / LOG_SCALE[1] ** 2
    if len(p) > 1:
        mean, width = np.transpose([*[ANY_ERRORS.error] * (len(p) - 2), ANY_ERRORS.seconds])
        away = (p[1:] - mean) / width
        total += 0.5 * float(away @ away)
        slope[1:] = away / width
    for one in tracks:
        cov = one.prior + scale * one.noise
        if len(p) > 1:
            std = np.exp(p[1:-1])
            lasting = lasting_covariance(one.slopes, one.t, std, float(np.exp(p[-1])))
            cov = cov + lasting
        inverse, alpha, nats = _solve_rows(cov, one.residual)
        total += nats
        worth = 0.5 * (inverse - np.outer(alpha, alpha))
        slope[0] += scale * float(np.vdot(worth, one.noise))
        if len(p) > 1:
            apart = np.abs(one.t[:, None] - one.t) / np.exp(p[-1])
            kept = worth * np.exp(-apart)
            slope[1:-1] += 2.0 * np.square(std) * (one.slopes * (kept @ one.slopes)).sum(axis=0)
            slope[-1] += float(np.vdot(worth * apart, lasting))
    return float(total), slope


def _score_error(tracks: Sequence[TrackResiduals], scale: float, seconds: float) -> float:
    """The slope of the likelihood by σ² at σ = 0, in its standard deviations."""
    score = 0.0
    information = 0.0
    for one in tracks:
        inverse, alpha, _ = _solve_rows(one.prior + scale * one.noise, one.residual)
        unit = np.ones(one.slopes.shape[1])
        shape = lasting_covariance(one.slopes, one.t, unit, seconds)
        weighed = inverse @ shape
        score += 0.5 * float(alpha @ shape @ alpha - np.trace(weighed))
        information += 0.5 * float(np.vdot(weighed, weighed.T))
    return float(score / np.sqrt(max(information, 1e-300)))


def _solve_rows(cov: Array, residual: Array) -> tuple[Array, Array, float]:
    """Inverse (R,R) of a covariance, it times the residual (R,), and −ln p up to a constant."""
    from scipy.linalg import lapack

    count = len(residual)
    chol, failed = lapack.dpotrf(
        cov + _JITTER * np.trace(cov) / count * np.eye(count), lower=1, clean=0
    )
    if failed:
        raise np.linalg.LinAlgError(f"the covariance of {count} residuals has no inverse")
    half, _ = lapack.dpotri(chol, lower=1)
    inverse = np.tril(half) + np.tril(half, -1).T
    alpha = inverse @ residual
    return inverse, alpha, 0.5 * float(residual @ alpha) + float(np.log(np.diag(chol)).sum())
