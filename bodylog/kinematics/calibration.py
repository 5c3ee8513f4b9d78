"""Estimate the unknowns θ from sightings: robust
Levenberg-Marquardt from several starts, with θ's covariance.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from .rig import IMAGES, SPACE, Rig

STEPS = 60
_SETTLED = 1e-5
_STUCK = 1e9
_COARSE = 80
_SCOUT = 12
_FINALISTS = 2
_POINTS = 12
_LEAST = 1e-6
_FALSE = 1e-3
"""Prior share of false sightings."""
_ANYWHERE = 600.0
"""px or mm: false sightings are uniform in a square or a cube of this side."""
CHI_SQUARE_MEDIANS = {1: 0.454936423119572, 2: float(2.0 * np.log(2.0)), 3: 2.3659738843753377}
"""The median of a sum of so many squares of standard normal numbers."""


@dataclass(frozen=True, eq=False)
class Sighted:
    """Measurements of one sight: q (N,M) rad or m · image
    (N,C,2) px, NaN where unseen · variance (N,C,2) px².

    Of points in space, 3 and mm in place of 2 and px.
    """

    q: Array
    image: Array
    variance: Array

    @property
    def seen(self) -> Array:
        """Which points were seen (N,C)."""
        return np.asarray(np.isfinite(self.image).all(axis=-1))

    @property
    def spread(self) -> float:
        """Root mean square motion of the points over all axes, px or mm."""
        seen = self.seen[..., None]
        middle = np.where(seen, self.image, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        return float(
            np.sqrt(
                np.square(np.where(seen, self.image - middle, 0.0)).sum()
                / max(self.image.shape[-1] * seen.sum(), 1)
            )
        )


@dataclass(frozen=True, eq=False)
class Calibrated:
    """theta (P,) of greatest posterior, and its covariance (P,P) if all points were independent.

    noise (2,): beyond the stated, px² in IMAGES and mm² in SPACE · weights per sight (N,C).

    evidence: log marginal likelihood of the sightings (nats), by Laplace's approximation at theta.
    """

    rig: Rig
    theta: Array
    covariance: Array
    noise: Array
    weights: tuple[Array, ...]
    evidence: float


def image_residuals(rig: Rig, theta: Array, data: Sequence[Sighted]) -> list[Array]:
    """Measured minus predicted (N,C,2) px, or (N,C,3) mm, of each sight; NaN where unseen."""
    return [
        one.image - rig.see(sight, theta, one.q).image
        for sight, one in zip(rig.sights, data, strict=True)
    ]


def calibrate_rig(rig: Rig, data: Sequence[Sighted], starts: Sequence[Array]) -> Calibrated:
    """Estimate θ from the best of several starts, with ever finer robust losses."""
    sparse, few = thin_sightings(rig, data, _COARSE)
    loss = [_arsinh_loss(50.0)] * 2
    coarse = [descend_robustly(sparse, few, start, loss, _UNIT, _SCOUT) for start in starts]
    coarse.sort(key=lambda found: found[1])
    coarse = [descend_robustly(sparse, few, found[0], loss, _UNIT) for found in coarse[:_FINALISTS]]
    best = min(coarse, key=lambda found: found[1])[0]
    for scale in (10.0, 3.0):
        best = descend_robustly(sparse, few, best, [_soft_l1_loss(scale)] * 2, _UNIT)[0]
    return refine_calibration(rig, data, best)


def scout_start(rig: Rig, data: Sequence[Sighted], start: Array) -> float:
    """Return the coarse loss after a short descent from one start."""
    sparse, few = thin_sightings(rig, data, _COARSE)
    return descend_robustly(sparse, few, start, [_arsinh_loss(50.0)] * 2, _UNIT, _SCOUT)[1]


def thin_sightings(rig: Rig, data: Sequence[Sighted], count: int) -> tuple[Rig, list[Sighted]]:
    """Keep at most `count` frames of each sight and _POINTS
    of its points, evenly spaced; θ keeps its meaning.
    """
    sights = []
    few = []
    for sight, one in zip(rig.sights, data, strict=True):
        rows = _evenly_spaced(len(one.q), count)
        points = _evenly_spaced(len(sight.points), _POINTS)
        sights.append(replace(sight, points=sight.points[points]))
        few.append(Sighted(one.q[rows], one.image[rows][:, points], one.variance[rows][:, points]))
    return replace(rig, sights=tuple(sights)), few


def _evenly_spaced(total: int, count: int) -> Array:
    return np.unique(np.linspace(0, total - 1, min(total, count)).round().astype(int))


def refine_calibration(
    rig: Rig, data: Sequence[Sighted], theta: Array, rounds: int = 8
) -> Calibrated:
    """From near the solution, alternate θ, noise and
    weights of false sightings until the noise settles.
    """
    noise = _variance_from_median(rig, theta, data)
    before = np.full(2, np.inf)
    for _ in range(rounds):
        weigh = mixtures(noise)
        theta, _ = descend_robustly(rig, data, theta, weigh, noise)
        noise = _variance_of_true_sightings(rig, theta, data, weigh)
        if (np.abs(noise - before) < 0.01 * noise).all():
            break
        before = noise
    return _finish_calibration(rig, data, theta, noise)


Loss = Callable[[Array], tuple[Array, Array]]
"""From squared residuals over their variance (…,): the
loss of each (2 × nats) and its derivative, the weight.
"""
_UNIT = np.ones(2)
"""A noise of 1 px² or mm²."""


def _soft_l1_loss(scale: float) -> Loss:
    """Soft-L1 loss with its knee at `scale` px."""

    def loss(square: Array) -> tuple[Array, Array]:
        root = np.sqrt(1.0 + square / scale**2)
        return 2.0 * scale**2 * (root - 1.0), 1.0 / root

    return loss


def _arsinh_loss(scale: float) -> Loss:
    """arsinh² loss with its knee at `scale` px: outliers lose influence with distance."""

    def loss(square: Array) -> tuple[Array, Array]:
        ratio = np.sqrt(square) / scale
        curve = np.arcsinh(ratio)
        weight = np.where(
            ratio > 1e-6, curve / np.maximum(ratio * np.sqrt(1.0 + ratio**2), 1e-6), 1.0
        )
        return scale**2 * curve**2, weight

    return loss


def mixtures(noise: Array) -> list[Loss]:
    """The mixture of images, in 2 dimensions, and that of space, in 3, with their noise (2,)."""
    return [_mixture(float(noise[IMAGES]), 2), _mixture(float(noise[SPACE]), 3)]


def _mixture(noise: float, size: int) -> Loss:
    """A Gaussian of one px² (times the noise) mixed with
    uniform false sightings: −2 ln((1 − ε) e^{−s/2} + ε').
    """
    floor = _FALSE * float((2.0 * np.pi * noise) ** (size / 2)) / _ANYWHERE**size

    def loss(square: Array) -> tuple[Array, Array]:
        near = np.exp(-0.5 * np.minimum(square, 1400.0))
        return -2.0 * np.log((near + floor) / (1.0 + floor)), near / (near + floor)

    return loss


def descend_robustly(
    rig: Rig,
    data: Sequence[Sighted],
    theta: Array,
    loss: Sequence[Loss],
    noise: Array,
    steps: int = STEPS,
) -> tuple[Array, float]:
    """θ (P,) of least loss from a start, and that loss;
    Levenberg-Marquardt with weights renewed at each step.

    loss, noise (2,): of IMAGES and of SPACE.
    """
    damping = 1e-3
    found = _normal_equations(rig, data, theta, loss, noise)
    std = rig.prior[1]
    for _ in range(steps):
        scaled = found.matrix * std * std[:, None]
        step = std * _solve_or_least_squares(
            scaled + damping * np.diag(np.diag(scaled)), found.pull * std
        )
        after = _normal_equations(rig, data, theta + step, loss, noise)
        if not after.value < found.value:
            damping *= 6.0
            if damping > _STUCK:
                break
            continue
        gain = found.value - after.value
        theta = theta + step
        found = after
        damping = max(damping / 6.0, 1e-12)
        if gain < _SETTLED * (1e-3 * found.value + 1.0) and damping < 1e-2:
            break
    return theta, found.value


def _solve_or_least_squares(matrix: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


@dataclass(frozen=True, eq=False)
class _Normal:
    """Gauss-Newton's normal matrix (P,P), right side (P,), and twice the loss."""

    matrix: Array
    pull: Array
    value: float


def _normal_equations(
    rig: Rig, data: Sequence[Sighted], theta: Array, loss: Sequence[Loss], noise: Array
) -> _Normal:
    mean, std = rig.prior
    matrix = np.diag(std**-2.0)
    pull = (mean - theta) / std**2
    value = float(np.square((theta - mean) / std).sum())
    for sight, one, kind in zip(rig.sights, data, rig.kinds, strict=True):
        seen = rig.see(sight, theta, one.q)
        valid = np.isfinite(one.image).all(axis=-1)
        residual = (one.image - seen.image)[valid]
        design = seen.design[valid]
        precision = 1.0 / (noise[kind] + one.variance[valid])
        cost, weight = loss[kind]((np.square(residual) * precision).sum(axis=-1))
        scaled = design * (weight[:, None] * precision)[..., None]
        matrix += np.tensordot(scaled, design, axes=([0, 1], [0, 1]))
        pull += np.tensordot(scaled, residual, axes=([0, 1], [0, 1]))
        value += float(cost.sum())
    return _Normal(matrix, pull, value)


def _variance_from_median(rig: Rig, theta: Array, data: Sequence[Sighted]) -> Array:
    """Variance (2,), px² and mm² per axis, from the median residual of each kind."""
    noise = np.ones(2)
    residuals = image_residuals(rig, theta, data)
    for kind in np.unique(rig.kinds):
        own = [r for r, other in zip(residuals, rig.kinds, strict=True) if other == kind]
        sizes = np.concatenate([np.square(r).sum(axis=-1).ravel() for r in own])
        noise[kind] = float(np.nanmedian(sizes)) / CHI_SQUARE_MEDIANS[own[0].shape[-1]]
    return np.asarray(np.maximum(noise, _LEAST))


def _variance_of_true_sightings(
    rig: Rig, theta: Array, data: Sequence[Sighted], loss: Sequence[Loss]
) -> Array:
    """Variance (2,), px² and mm² per axis, of true sightings,
    over the degrees of freedom that θ leaves.
    """
    total = np.zeros(2)
    count = np.zeros(2)
    noise = _variance_from_median(rig, theta, data)
    for residual, kind in zip(image_residuals(rig, theta, data), rig.kinds, strict=True):
        square = np.square(residual).sum(axis=-1)
        square = square[np.isfinite(square)]
        weight = loss[kind](square / noise[kind])[1]
        total[kind] += float(weight @ square)
        count[kind] += residual.shape[-1] * float(weight.sum())
    matrix = _normal_equations(rig, data, theta, loss, noise).matrix
    known = np.zeros(2)
    for kind, part, rows in rig.split_by_kind():
        share = _normal_equations(part, [data[k] for k in rows], theta, loss, noise).matrix
        own = share - np.diag(rig.prior[1] ** -2.0)
        known[kind] = float(np.trace(np.linalg.solve(matrix, own)))
    return variance_by_kind(total, count, known, _LEAST)


def variance_by_kind(total: Array, count: Array, known: Array, least: float) -> Array:
    """Variance (2,) from sums of squares (2,) over numbers (2,)
    of which θ takes up `known` (2,); 1 of a kind that is not there.
    """
    left = np.maximum(np.maximum(count - known, 0.1 * count), 1.0)
    return np.where(count > 0.0, np.maximum(total / left, least), 1.0)


def _finish_calibration(
    rig: Rig, data: Sequence[Sighted], theta: Array, noise: Array
) -> Calibrated:
    weigh = mixtures(noise)
    found = _normal_equations(rig, data, theta, weigh, noise)
    std = rig.prior[1]
    scaled = found.matrix * std * std[:, None]
    covariance = np.linalg.inv(scaled) * std * std[:, None]
    weights = []
    entropy = 0.0
    for residual, one, kind in zip(image_residuals(rig, theta, data), data, rig.kinds, strict=True):
        precision = 1.0 / (noise[kind] + one.variance)
        square = (np.square(residual) * precision).sum(axis=-1)
        seen = np.isfinite(square)
        weights.append(np.where(seen, weigh[kind](np.where(seen, square, 0.0))[1], 0.0))
        entropy += float(np.log(2.0 * np.pi / precision[seen]).sum())
    evidence = float(-0.5 * (found.value + entropy + np.linalg.slogdet(scaled)[1]))
    return Calibrated(rig, theta, covariance, noise, tuple(weights), evidence)
