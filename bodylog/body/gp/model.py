"""Gaussian-process forward model: mean, Jacobian and
variance at one point or at many (paper, "Body learning").
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ...types import TRACK_AXES, Array

_BLOCK_BYTES = 1 << 19
_SOME = 64
"""Samples at which the correlation length of errors is estimated."""
_STEP = 1e-3
"""rad: to either side, where the growth of errors is taken from differences."""

MISFIT = 1.2
"""Factor on the posterior variance for model misfit: projected arms are rougher than draws of a
squared exponential. The least that several arms showed; docs/learning.md has the figures."""

NEGLIGIBLE = 1e-6
"""Relative error of the variance that may come from dropping uninformative directions."""


@dataclass(frozen=True, eq=False)
class GP:
    """One sense's learned model: D outputs on shared centres,
    one squared-exponential kernel (G=1) or one each (G=D).

    outputs (D,) names · unit of the outputs · centres (n,M) rad · scales (G,M) rad · amplitude (G,)
    unit² · mean (D,) unit · weights (D,n) · factor (G,r,n): variance = MISFIT (amplitude − |factor
    k|²) · noise (D,) unit² beyond the samples' own · samples (S,M) rad, targets (S,D), spread (S,D)
    unit²: the training data. Outputs that share a kernel share it in units of their own noise: each
    one's variance is its `share` times that.
    """

    outputs: tuple[str, ...]
    unit: str
    centres: Array
    scales: Array
    amplitude: Array
    mean: Array
    weights: Array
    factor: Array
    noise: Array
    samples: Array
    targets: Array
    spread: Array
    misfit: ClassVar[float] = MISFIT

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (N,M) rad: mean (N,D) · Jacobian (N,D,M)
        per rad · variance (N,D), sensor noise excluded.
        """
        x = np.atleast_2d(x)
        if len(x) == 1:
            value, slope, spread = self.predict_one(x[0])
            return value[None], slope[None], spread[None]
        parts = [single.many(x - self._origin) for single in self._singles]
        if len(parts) == 1:
            return parts[0]
        value, slope, spread = (
            np.concatenate(column, axis=1) for column in zip(*parts, strict=True)
        )
        return value, slope, spread

    def predict_one(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at one x (M,) rad: mean (D,) · Jacobian (D,M) per rad · variance (D,)."""
        offset = x - self._origin
        parts = [single.at(offset) for single in self._singles]
        if len(parts) == 1:
            return parts[0]
        value, slope, spread = zip(*parts, strict=True)
        return np.concatenate(value), np.concatenate(slope), np.concatenate(spread)

    def means(self, x: Array) -> tuple[Array, Array]:
        """Predict at x (N,M) rad: mean (N,D) · Jacobian
        (N,D,M) per rad, without the variance: O(N n).
        """
        parts = [single.means(x - self._origin) for single in self._singles]
        if len(parts) == 1:
            return parts[0]
        value, slope = (np.concatenate(column, axis=1) for column in zip(*parts, strict=True))
        return value, slope

    def covariance(self, x: Array) -> Array:
        """Covariance of the model's error between all pairs of
        x (N,M) rad: (G,N,N) unit², for outputs of `share` 1.
        """
        result = np.empty((len(self.scales), len(x), len(x)))
        for group, scales in enumerate(self.scales):
            kernel = se_kernel(x / scales, self.centres / scales, self.amplitude[group])
            projected = self._projected(group, kernel)
            result[group] = MISFIT * (
                se_kernel(x / scales, x / scales, self.amplitude[group]) - projected @ projected.T
            )
        return result

    def slope_variance(self, x: Array) -> Array:
        """Variance of the Jacobian at x (N,M) rad: (N,D,M) per rad squared."""
        result = np.empty((len(x), len(self.mean), x.shape[1]))
        for group, scales in enumerate(self.scales):
            members = self._members(group)
            for rows in _cache_sized_slices(len(x), len(self.centres)):
                kernel = se_kernel(x[rows] / scales, self.centres / scales, self.amplitude[group])
                for m, scale in enumerate(scales):
                    lean = kernel * (self.centres[:, m] - x[rows, m, None]) / scale**2
                    left = self.amplitude[group] / scale**2 - np.square(
                        self._projected(group, lean)
                    ).sum(axis=-1)
                    result[rows, members, m] = np.maximum(left, 0.0)[:, None] * (
                        MISFIT * self.share[members]
                    )
        return result

    def _projected(self, group: int, kernel: Array) -> Array:
        """factor · k for kernel (N,n): (N,r)."""
        return np.asarray(kernel @ self.factor[group].T)

    def _members(self, group: int) -> list[int]:
        return list(range(len(self.mean))) if len(self.scales) == 1 else [group]

    @cached_property
    def share(self) -> Array:
        """Factor (D,) of each output's noise and variance
        over the mean of those that share its kernel.
        """
        return variance_shares(self.spread) if len(self.scales) == 1 else np.ones(len(self.mean))

    @cached_property
    def reach(self) -> Array:
        """Correlation length (M,) rad of the model's
        errors: they correlate by exp(−½ Σ (δ/reach)²).

        From the curvature at zero: the variance of the error's slope, less what its deviation
        grows, over that of the error, at the samples. Points in space are known so well on the
        path of an exploration that errors beside it are many times as large, and logs go there:
        for them at angles of the samples, those of each joint from other samples.
        """
        x = self.samples
        if len(self.mean) == len(TRACK_AXES[3][0]):
            turns = np.arange(x.shape[1]) * (len(x) // x.shape[1])
            x = np.column_stack([np.roll(own, n) for own, n in zip(x.T, turns, strict=True)])
        x = x[:: max(1, len(x) // _SOME)]
        # a variance below this share of the amplitude is rounding
        error = max(self.predict(x)[2].mean(), np.finfo(float).eps * self.amplitude.max())
        grown = [
            np.subtract(*(np.sqrt(self.predict(x + way)[2]) for way in (step, -step)))
            for step in _STEP * np.eye(x.shape[1])
        ]
        lean = self.slope_variance(x) - np.square(np.stack(grown, axis=2) / (2.0 * _STEP))
        bend = lean.mean(axis=(0, 1)) / error
        return np.asarray(1.0 / np.sqrt(np.maximum(bend, np.finfo(float).tiny)))

    @cached_property
    def _origin(self) -> Array:
        return np.asarray(self.centres.mean(axis=0))

    @cached_property
    def _singles(self) -> list["_Single"]:
        return [self._single(group) for group in range(len(self.scales))]

    def _single(self, group: int) -> "_Single":
        near = self.centres - self._origin
        precision = self.scales[group] ** -2.0
        members = self._members(group)
        amplitude = float(self.amplitude[group])
        fixed = -0.5 * np.square(near) @ precision
        leans = (self.weights[members][:, None] * (near * precision).T).reshape(-1, len(near))
        # amplitude here, not in the exponent: large exponents
        # round more, and the variance is a difference
        rows = amplitude * np.concatenate([self.weights[members], leans, self.factor[group]])
        near = np.asfortranarray(near)
        rows = np.asfortranarray(rows)
        return _Single(
            near,
            fixed,
            precision,
            rows,
            self.mean[members],
            MISFIT * self.share[members],
            amplitude,
        )


@dataclass(frozen=True, eq=False)
class _Single:
    """One kernel's D outputs: all that is linear in the kernel as one product.

    near (n,M) centres · fixed (n,) ln k at the origin, where k is 1 at its centre · precision (M,)
    · mean (D,) · share (D,) of the variance · amplitude · rows (D+DM+r,n), amplitude times:
    weights, weights times centres times precision, factor.
    """

    near: Array
    fixed: Array
    precision: Array
    rows: Array
    mean: Array
    share: Array
    amplitude: float

    def at(self, offset: Array) -> tuple[Array, Array, Array]:
        """Mean (D,), Jacobian (D,M) and variance (D,)
        at an offset (M,) from the origin of `near`.
        """
        kernel, tilt = self.kernel(offset)
        return self.evaluate(self.rows.dot(kernel), tilt)

    def kernel(self, offset: Array) -> tuple[Array, Array]:
        """At an offset (M,) from the origin of `near`: k (n,)
        of amplitude 1; the offset times the precision (M,).
        """
        # method calls: the operators' overhead is as large as the product of 46 samples
        tilt = offset * self.precision
        kernel = self.near.dot(tilt)
        kernel += self.fixed
        kernel -= 0.5 * offset.dot(tilt)
        return np.exp(kernel, out=kernel), tilt

    def evaluate(self, sums: Array, tilt: Array) -> tuple[Array, Array, Array]:
        """Mean (D,), Jacobian (D,M) and variance (D,) of rows · k."""
        outputs = len(self.mean)
        inputs = len(tilt)
        value = sums[:outputs]
        leans = sums[outputs : outputs * (1 + inputs)]
        seen = sums[outputs * (1 + inputs) :]
        slope = leans.reshape(outputs, inputs) - value[:, None] * tilt
        return (
            value + self.mean,
            slope,
            max(self.amplitude - float(seen.dot(seen)), 0.0) * self.share,
        )

    def many(self, offset: Array) -> tuple[Array, Array, Array]:
        """Mean (N,D), Jacobian (N,D,M) and variance (N,D) at offsets (N,M)."""
        left = np.empty(len(offset))
        value, slope = self.means(offset, left)
        return value, slope, np.maximum(left, 0.0)[:, None] * self.share

    def means(self, offset: Array, left: Array | None = None) -> tuple[Array, Array]:
        """Mean (N,D) and Jacobian (N,D,M) at offsets
        (N,M); `left` (N,) receives the remaining variance.

        Computed by blocks that fit the cache; the kernel's
        logarithm is linear in [x/l², 1, −x·x/2l²].
        """
        outputs = len(self.mean)
        inputs = offset.shape[1]
        linear = outputs * (1 + inputs)
        tilt = (offset * self.precision).T
        rows = self.rows[:linear] if left is None else self.rows
        below = np.vstack([tilt, np.ones(len(offset)), -0.5 * (offset.T * tilt).sum(axis=0)])
        above = np.column_stack([self.near, self.fixed, np.ones(len(self.fixed))])
        value = np.empty((len(offset), outputs))
        slope = np.empty((len(offset), outputs, inputs))
        for block in _cache_sized_slices(len(offset), len(self.fixed)):
            kernel = above @ below[:, block]
            sums = rows @ np.exp(kernel, out=kernel)
            leans = (
                sums[outputs:linear].reshape(outputs, inputs, -1)
                - sums[:outputs, None] * tilt[:, block]
            )
            value[block] = sums[:outputs].T + self.mean
            slope[block] = np.moveaxis(leans, -1, 0)
            if left is not None:
                left[block] = self.amplitude - np.einsum("rn,rn->n", sums[linear:], sums[linear:])
        return value, slope


def _cache_sized_slices(count: int, width: int) -> Iterator[slice]:
    """Row slices of a (count, width) array that fit the cache."""
    step = max(1, _BLOCK_BYTES // (8 * width))
    return (slice(start, min(start + step, count)) for start in range(0, count, step))


def drop_negligible_rows(gp: GP) -> GP:
    """Drop rows r of the factor while the variance
    changes by at most NEGLIGIBLE of itself at every x.

    With F the factor and K the Gram matrix of the centres, F K Fᵀ has eigenvalues λ/(1+λ), where λ
    is signal over noise along an eigenvector. The prior bounds k(x) by its amplitude, so rows up to
    λ change a variance v by at most λ v.
    """
    short = []
    for factor, scales, amplitude in zip(gp.factor, gp.scales, gp.amplitude, strict=True):
        gram = se_kernel(gp.centres / scales, gp.centres / scales, amplitude)
        values, vectors = np.linalg.eigh(factor @ gram @ factor.T)
        short.append((values, vectors.T @ factor))
    rank = max(int((values > NEGLIGIBLE).sum()) for values, _ in short)
    return replace(gp, factor=np.array([factor[-rank:] for _, factor in short]))


def variance_shares(variance: Array) -> Array:
    """Mean variances (D,) of variances (n,D) over their mean; all 1 where one is 0."""
    means = variance.mean(axis=0)
    return np.asarray(means / means.mean()) if means.all() else np.ones(len(means))


def se_kernel(a: Array, b: Array, amplitude: float) -> Array:
    """Squared-exponential kernel between a (N,M) and b
    (n,M), both divided by their length scales: (N,n).
    """
    half_a = np.square(a).sum(axis=1)
    half_b = np.square(b).sum(axis=1)
    left, right = (np.ones((len(part), part.shape[1] + 2)) for part in (a, b))
    left[:, :-2] = a
    left[:, -1] = -0.5 * half_a
    right[:, :-2] = b
    right[:, -2] = -0.5 * half_b
    exponent = left @ right.T
    np.minimum(exponent, 0.0, out=exponent)
    np.exp(exponent, out=exponent)
    exponent *= amplitude
    return np.asarray(exponent)
