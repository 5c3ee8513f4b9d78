"""The unknowns that alone predict images best,
with joints' zeros within the error bars of what is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array
from .calibration import Sighted, mixtures, variance_by_kind
from .rig import Rig, Sight

JOINT_ERROR_STD = 1e-4
"""rad or m: how far a joint may be from its reading at one posture, beyond its zero.

An arm's usual repeatability of 0.1 mm at a reach of 1 m. All corners of an image err with the arm:
without this error they would count as so many independent ones.
"""
_ROUNDS = 6
_STEPS = 30
_HALVINGS = 8
_SETTLED = 1e-3
"""Posterior standard deviations of the step that ends a descent."""
_SETTLED_NOISE = 0.01
_LEAST_NOISE = 1e-6
MOST_SIGMA = 2.0
"""Standard deviations by which an unknown may be away from what is known of it."""
ZERO_SIGMA = 0.5
"""The same for a joint's zero or scale, before the rest is held: see docs/decisions.md."""
_WEIGHTS = (-12.0, 12.0)
"""Logarithms of the least and the largest weight of what is known."""
_BISECTIONS = 40


@dataclass(frozen=True, eq=False)
class Posed:
    """Sightings of one sight: variance (N,M), rad² or m², of their angles · log (N,) of each image.

    group (N,): images whose errors are correlated, over all
    sights: those of one posture, or of a stretch of a log.
    """

    sighted: Sighted
    variance: Array
    log: Array
    group: Array


@dataclass(frozen=True, eq=False)
class Adjusted:
    """theta (P,) of least error, and its covariance (P,P) ·
    curvature (P,P): the loss's inverse second derivative · left_out (G,) px² or mm²: squared error
    of each group, predicted by θ of least error without it.
    """

    rig: Rig
    theta: Array
    covariance: Array
    curvature: Array
    left_out: Array


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of some unknowns, in rows (K,) of θ: mean (K,) and covariance (K,K)."""

    rows: Array
    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class _Prior:
    """mean (P,) · precision (P,P) in prior deviations."""

    mean: Array
    precision: Array


def adjust(rig: Rig, data: Sequence[Posed], theta: Array, noise: Array, known: Known) -> Adjusted:
    """Adjust θ from near the solution: the least error by θ alone,
    with zeros and scales within the error bars of what is known.

    noise (2,): first value of the variance (px² or mm², per axis) of a point. A process of
    residuals beside θ takes up part of what θ explains, so θ of such a model alone has not the least error (Tuo &
    Wu 2015, "Efficient calibration for imperfect computer models"); but θ of least error takes up
    part of what no θ explains. So zeros and scales are first held within ZERO_SIGMA of the former,
    `known`, and then all within MOST_SIGMA, by weights of the loss about each solution. The
    covariance is the mean square error of this θ where `known` holds: its covariance, and the
    square of the step away from its mean.
    """
    mean, std = rig.prior
    prior = _Prior(mean, np.eye(len(std)))
    found = _adjusted(rig, data, theta, noise, prior)
    left_out = float(found.noise[list(rig.kinds)].mean()) * _left_out_losses(found.normal)
    for part, most in ((_known_zeros(rig, known), ZERO_SIGMA), (known, MOST_SIGMA)):
        weight = _least_weight(found, part, most, std)
        if weight > 0.0:
            prior = _with_known(prior, part, weight, std)
            found = _adjusted(rig, data, found.theta, found.noise, prior)
    unit = std * std[:, None]
    away = found.theta - known.mean
    covariance = known.covariance + np.outer(away, away)
    inverse_of_loss = np.linalg.inv(found.normal.matrix)
    return Adjusted(rig, found.theta, covariance, inverse_of_loss * unit, left_out)


def _known_zeros(rig: Rig, known: Known) -> Known:
    """What is known of zeros and scales alone."""
    chosen = np.flatnonzero(known.rows >= rig.of_joints.start)
    return Known(known.rows[chosen], known.mean[chosen], known.covariance[np.ix_(chosen, chosen)])


def _with_known(prior: _Prior, known: Known, weight: float, std: Array) -> _Prior:
    """The prior and the known values of some unknowns, weighted."""
    rows = known.rows
    inverse = weight * np.linalg.inv(known.covariance / std[rows] / std[rows, None])
    precision = prior.precision.copy()
    precision[np.ix_(rows, rows)] += inverse
    pull = np.zeros(len(std))
    pull[rows] = inverse @ ((known.mean - prior.mean[rows]) / std[rows])
    return _Prior(prior.mean + std * np.linalg.solve(precision, pull), precision)


@dataclass(frozen=True, eq=False)
class _Solution:
    """θ (P,), the normal equations there, and the variance (2,), px² and mm², of a point."""

    theta: Array
    normal: "_Normal"
    noise: Array


def _adjusted(
    rig: Rig, data: Sequence[Posed], theta: Array, noise: Array, prior: _Prior
) -> _Solution:
    """Generalised least squares from a start, with
    false sightings weighed down and the noise learned.
    """
    for _ in range(_ROUNDS):
        weights = [
            _weights(_squares(rig, k, theta, one), noise, rig.kinds[k])
            for k, one in enumerate(data)
        ]
        theta, found = _descended(rig, data, weights, theta, noise, prior)
        before = noise
        noise = _noise(rig, data, weights, theta, found, noise, prior)
        if (np.abs(noise - before) < _SETTLED_NOISE * before).all():
            break
    return _Solution(theta, found, noise)


def _least_weight(free: _Solution, known: Known, most: float, std: Array) -> float:
    """The least weight of what is known with which no unknown is
    farther from it than `most` of its sigmas; 0 if none is needed.

    Along the quadratic loss about the free solution.
    """
    unit = std[known.rows]
    inverse = np.linalg.inv(known.covariance / unit / unit[:, None])
    precision = np.linalg.inv(np.linalg.inv(free.normal.matrix)[np.ix_(known.rows, known.rows)])
    pull = precision @ ((free.theta[known.rows] - known.mean) / unit)
    sigma = np.sqrt(np.diag(known.covariance)) / unit

    def farthest(weight: float) -> float:
        return float(np.max(np.abs(np.linalg.solve(precision + weight * inverse, pull)) / sigma))

    if farthest(0.0) <= most:
        return 0.0
    low, high = _WEIGHTS
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if farthest(float(np.exp(middle))) > most else (low, middle)
    return float(np.exp(high))


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal matrix (P,P) and right side (P,), in prior
    deviations · twice the loss · each group's share of both.
    """

    matrix: Array
    pull: Array
    value: float
    matrices: Array
    pulls: Array
    values: Array


def _descended(
    rig: Rig,
    data: Sequence[Posed],
    weights: Sequence[Array],
    theta: Array,
    noise: Array,
    prior: _Prior,
) -> tuple[Array, _Normal]:
    """Gauss-Newton with halved steps, for given weights (N,C) of the points."""
    std = rig.prior[1]
    found = _normal(rig, data, weights, theta, noise, prior)
    for _ in range(_STEPS):
        step = np.linalg.solve(found.matrix, found.pull)
        size = float(np.sqrt(step @ found.matrix @ step))
        for _ in range(_HALVINGS):
            after = _normal(rig, data, weights, theta + std * step, noise, prior)
            if after.value <= found.value:
                break
            step = 0.5 * step
        else:
            break
        theta = theta + std * step
        found = after
        if size < _SETTLED:
            break
    return theta, found


def _normal(
    rig: Rig,
    data: Sequence[Posed],
    weights: Sequence[Array],
    theta: Array,
    noise: Array,
    prior: _Prior,
) -> _Normal:
    std = rig.prior[1]
    names, group = np.unique(np.concatenate([one.group for one in data]), return_inverse=True)
    shares = np.zeros((len(names), len(std) + 1, len(std) + 1))
    begin = 0
    for k, (one, weight) in enumerate(zip(data, weights, strict=True)):
        sight = rig.sights[k]
        own_noise = float(noise[rig.kinds[k]])
        end = begin + len(one.group)
        np.add.at(shares, group[begin:end], _products(rig, sight, theta, one, weight, own_noise))
        begin = end
    whole = shares.sum(axis=0)
    away = (prior.mean - theta) / std
    value = float(whole[-1, -1] + away @ prior.precision @ away)
    matrix = whole[:-1, :-1] + prior.precision
    return _Normal(
        matrix,
        whole[:-1, -1] + prior.precision @ away,
        value,
        shares[:, :-1, :-1],
        shares[:, :-1, -1],
        shares[:, -1, -1],
    )


def _products(
    rig: Rig, sight: Sight, theta: Array, one: Posed, weight: Array, noise: float
) -> Array:
    """Products (N,P+1,P+1) of design and residual of each
    image, weighted by the inverse of its points' covariance.

    That is W⁻¹ + J V Jᵀ: the points' own, and that of the
    angles V through the slopes J (Woodbury's identity).
    """
    seen = rig.see(sight, theta, one.sighted.q, one.log)
    images = len(one.group)
    there = weight[..., None] > 0.0
    precision = np.where(there, weight[..., None] / (noise + one.sighted.variance), 0.0).reshape(
        images, -1
    )
    residual = np.where(there, one.sighted.image - seen.image, 0.0).reshape(images, -1, 1)
    design = (seen.design * rig.prior[1]).reshape(images, residual.shape[1], -1)
    both = np.concatenate([design, residual], axis=2)
    slope = seen.slope.reshape(images, residual.shape[1], -1)
    slope = slope * np.sqrt(one.variance + JOINT_ERROR_STD**2)[:, None]
    weighted = (precision[..., None] * slope).transpose(0, 2, 1)
    inner = np.eye(slope.shape[2]) + weighted @ slope
    across = weighted @ both
    own = both.transpose(0, 2, 1) @ (precision[..., None] * both)
    return np.asarray(own - across.transpose(0, 2, 1) @ np.linalg.solve(inner, across))


def _squares(rig: Rig, index: int, theta: Array, one: Posed) -> Array:
    """Squared distance (N,C), px² or mm², of each point from
    where it is predicted; NaN where it was not seen.
    """
    seen = rig.see(rig.sights[index], theta, one.sighted.q, one.log)
    return np.asarray(np.square(one.sighted.image - seen.image).sum(axis=-1))


def _weights(square: Array, noise: Array, kind: int) -> Array:
    """How likely each point (N,C) is no false sighting; 0 where it was not seen."""
    seen = np.isfinite(square)
    weigh = mixtures(noise)[kind]
    return np.where(seen, weigh(np.where(seen, square, 0.0) / noise[kind])[1], 0.0)


def _noise(
    rig: Rig,
    data: Sequence[Posed],
    weights: Sequence[Array],
    theta: Array,
    found: _Normal,
    noise: Array,
    prior: _Prior,
) -> Array:
    """Variance (2,), px² and mm² per axis, of a point about
    θ, over the degrees of freedom that θ leaves.
    """
    total = np.zeros(2)
    count = np.zeros(2)
    for k, (one, weight) in enumerate(zip(data, weights, strict=True)):
        total[rig.kinds[k]] += float(np.nansum(weight * _squares(rig, k, theta, one)))
        count[rig.kinds[k]] += one.sighted.image.shape[-1] * float(weight.sum())
    known = np.zeros(2)
    for kind, part, rows in rig.split_by_kind():
        few = [data[k] for k in rows]
        share = _normal(part, few, [weights[k] for k in rows], theta, noise, prior).matrix
        own = share - prior.precision
        known[kind] = float(np.trace(np.linalg.solve(found.matrix, own)))
    return variance_by_kind(total, count, known, _LEAST_NOISE)


def _left_out_losses(found: _Normal) -> Array:
    """Loss (G,) of each group about θ without it, along the quadratic loss about θ."""
    moved = np.linalg.solve(found.matrix - found.matrices, found.pulls[..., None])[..., 0]
    return np.asarray(
        found.values
        + 2.0 * np.einsum("gp,gp->g", moved, found.pulls)
        + np.einsum("gp,gpq,gq->g", moved, found.matrices, moved)
    )
