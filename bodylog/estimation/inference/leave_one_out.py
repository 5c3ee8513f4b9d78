"""Predictions of each reading from all others of a smoothed log, and the outliers that they show.

A reading y = H x + n with noise R leaves the residual ε = y − H x̂ of covariance R − A, where A = H
P Hᵀ is by the smoothed belief. All other readings predict it with the error R (R − A)⁻¹ ε, of
covariance R (R − A)⁻¹ R (de Jong 1988). Where the reading was not used, these are ε and R + A.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...linear_algebra import project_covariance
from ...types import Array
from ..measurements.records import unmix_rows
from .filter_pass import FLAT_COST_NATS, GATE_SIGMA
from .filter_problem import FilterProblem
from .solution import Smooth

MIN_VARIANCE_SHARE = 1e-3
"""Least share of R that R − A is, above the rounding
of A after a wide prior, which is up to 4e-5 of R.
"""


class LeftOut(NamedTuple):
    """Each reading as all others predict it.

    encoders (N,M): errors of encoders, in standard deviations · of each sighting: places, mean
    (F,D), covariance (F,D,D) and the model's variance (F,D), without the noise of the frame itself;
    squares (F,): errors over their covariance · nats (N,M), then (F,): cost of readings that were
    removed, else 0 · gated: whether the smoother's forward pass took any for outliers.
    """

    encoders: Array
    places: tuple[tuple[Array, Array, Array], ...]
    squares: tuple[Array, ...]
    nats: tuple[Array, ...]
    gated: bool


@dataclass(frozen=True, eq=False)
class SmoothedWithResiduals(Smooth):
    """A smoothed log, with each reading as all others predict it."""

    left_out: LeftOut


def predict_left_out(problem: FilterProblem, smooth: Smooth) -> LeftOut:
    """Predict each reading of the problem by a smoothed log from which some may be removed."""
    d = smooth.trace.encoder_d
    var = np.einsum("eoo->eo", smooth.cov)
    encoders, nats = _predict_left_out_encoders(problem, smooth.z, var, d, smooth.readings.gate)
    frames = [
        _predict_left_out_frames(problem, smooth, index)
        for index in range(len(problem.evidence.sightings))
    ]
    places, squares, costs, far = zip(*frames, strict=True) if frames else ((), (), (), ())
    gated = bool((np.abs(d) > smooth.readings.gate).any()) or any(rows.any() for rows in far)
    return LeftOut(encoders, places, squares, (nats, *costs), gated)


def _predict_left_out_encoders(
    problem: FilterProblem, x: Array, var: Array, d: Array, gate: float
) -> tuple[Array, Array]:
    """Errors and nats (N,M); smoothed x (E,K), their
    variances var (E,O), innovations d (E,M), gated.
    """
    encoders = problem.evidence.encoders
    at = problem.timeline.encoders
    m = len(problem.start)
    if encoders is None:
        return np.empty((0, m)), np.empty((0, m))
    offset = problem.dynamics.offset
    read = x[at, :m] if offset is None else x[at, :m] + x[at, offset:]
    noise = problem.precision.encoder * encoders.relative_variance
    used = np.abs(d[at]) <= gate
    a = np.maximum(var[at, -m:], 0.0)  # not below 0 by rounding
    total = np.where(used, np.maximum(noise - a, MIN_VARIANCE_SHARE * noise), noise + a)
    errors = (encoders.values - read) / np.sqrt(total)
    removed = np.isnan(d[at]) & np.isfinite(errors)
    nats = np.zeros(errors.shape)
    nats[removed] = _compute_removal_cost(
        np.square(errors[removed]), np.log(2.0 * np.pi * total[removed])
    )
    return errors, nats


def _predict_left_out_frames(
    problem: FilterProblem, smooth: Smooth, index: int
) -> tuple[tuple[Array, Array, Array], Array, Array, Array]:
    """Places, squares and nats of a sighting's frames, and which were gated.

    A frame that is a line over a belief cannot be left out by its tangent: it is compared with the
    belief that holds it.
    """
    sighting = problem.evidence.sightings[index]
    at = problem.timeline.sightings[index]
    m = len(problem.start)
    values, _, mix = sighting.independent_rows
    x = smooth.z[at, :m]
    removed = np.isnan(smooth.readings.y[at, index, 0])
    mean, jac, var = smooth.tangents.predict_from_tangents(index, x)
    noise = smooth.tangents.var[index]
    apart = removed | ~smooth.tangents.find_written_frames(problem, smooth.readings, index)
    std = np.sqrt(noise + var * apart[:, None])
    # rows in units of their noise, so that R is 1
    residual = (values - mean) / std
    h = jac / std[..., None]
    far = ~apart & _find_gated_frames(smooth, at, index)
    a = project_covariance(h, smooth.cov[at, :m, :m])
    used = ~(apart | far)[:, None, None]
    identity = np.eye(h.shape[1])
    inverse, log_total = _invert_with_log_determinant(identity + np.where(used, -a, a))
    scaled = np.einsum("fde,fe->fd", inverse, residual)
    square = (scaled * residual).sum(axis=1)
    log_size = log_total + np.log(2.0 * np.pi * std * std).sum(axis=1)
    error = std * np.where(used[..., 0], scaled, residual)
    spread = np.where(used, inverse - identity, a)
    place = np.where(np.isfinite(error), values - error, mean)
    nats = np.where(removed & np.isfinite(square), _compute_removal_cost(square, log_size), 0.0)
    return unmix_rows(mix, (place, std[..., None] * spread * std[:, None], var)), square, nats, far


def _invert_with_log_determinant(symmetric: Array) -> tuple[Array, Array]:
    """Inverses of matrices (F,D,D) and the logarithms
    (F,) of their determinants, by the sweep operator.
    """
    s = np.moveaxis(symmetric, 0, -1).copy()
    log_size = np.zeros(len(symmetric))
    for k in range(len(s)):
        pivot = np.maximum(s[k, k], MIN_VARIANCE_SHARE)
        row = s[k] / pivot
        s = s - s[:, k, None] * row
        s[k] = row
        s[:, k] = row
        s[k, k] = -1.0 / pivot
        log_size += np.log(pivot)
    return -np.moveaxis(s, -1, 0), log_size


def _find_gated_frames(smooth: Smooth, at: Array, index: int) -> Array:
    """Which frames (F,) of a sighting the forward pass
    rejected: their information is less than by their variance.
    """
    var = smooth.readings.var
    information = smooth.trace.information
    assert information is not None
    first = information.shape[1] + (index - var.shape[1]) * var.shape[2]
    used = information[at, first] * var[at, index, 0]
    return np.asarray(used < 1.0 - 1e-12)


def _compute_removal_cost(d2: Array, log_size: Array) -> Array:
    """Nats of removed readings with squares d2 and ln|2π
    S|: they grow with distance, as those of `outlier_cost`.
    """
    over = np.fmax(d2 / GATE_SIGMA**2, 1.0)
    return np.asarray(
        0.5 * (np.fmin(d2, GATE_SIGMA**2) + log_size) + FLAT_COST_NATS * (1.0 - 1.0 / over)
    )


def find_contradicted_readings(left_out: LeftOut) -> tuple[Array, ...]:
    """Readings that all others contradict: encoders'
    (N,M) bool, then frames (F,) of each sighting.
    """
    return (
        np.abs(left_out.encoders) > GATE_SIGMA,
        *(square > GATE_SIGMA**2 for square in left_out.squares),
    )


def remove_readings(problem: FilterProblem, removed: tuple[Array, ...]) -> FilterProblem:
    """The problem without the readings that are removed:
    encoders' (N,M) bool, then frames (F,) of each sighting.
    """
    evidence = problem.evidence
    encoders, *frames = removed
    sightings = tuple(
        replace(sighting, values=np.where(far[:, None], np.nan, sighting.values))
        for sighting, far in zip(evidence.sightings, frames, strict=True)
    )
    rows = evidence.encoders and replace(
        evidence.encoders, values=np.where(encoders, np.nan, evidence.encoders.values)
    )
    return replace(problem, evidence=replace(evidence, encoders=rows, sightings=sightings))


def compute_smoothed_free_energy(
    problem: FilterProblem, smooth: Smooth, left_out: LeftOut
) -> Array:
    """Nats (E,) of a smoothed log and of the readings removed from it."""
    nats = smooth.trace.nats.copy()
    line = problem.timeline
    encoders, *frames = left_out.nats
    nats[line.encoders] += encoders.sum(axis=1)
    for at, cost in zip(line.sightings, frames, strict=True):
        nats[at] += cost
    return nats
