"""Gaussian-process forward model: mean, Jacobian and variance at one point or at many (paper, "Body learning")."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..types import Array

_BLOCK_BYTES = 4 << 20


@dataclass(frozen=True, eq=False)
class GP:
    """One sense's learned model; every output has its own squared-exponential kernel on shared centres.

    outputs (D,) names · unit of the outputs · centres (n,M) rad · scales (D,M) rad · amplitude (D,) unit² ·
    mean (D,) unit · weights (D,n) · factor (D,n,n): variance = amplitude − |factor k|² · noise (D,) unit² found
    beyond the samples' own · samples (S,M) rad, targets (S,D), spread (S,D) unit²: what it was learned from.
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

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """At x (N,M) rad: mean (N,D) · Jacobian (N,D,M) per rad · variance (N,D), sensor noise excluded."""
        x = np.atleast_2d(x)
        if len(x) == 1:
            value, slope, spread = self.predict_one(x[0])
            return value[None], slope[None], spread[None]
        count, (outputs, inputs) = len(x), self.scales.shape
        value, slope = np.empty((count, outputs)), np.empty((count, outputs, inputs))
        spread = np.empty((count, outputs))
        for d, rows, kernel in self._kernels(x):
            value[rows, d], slope[rows, d] = self._linear(d, x[rows], kernel)
            spread[rows, d] = self.amplitude[d] - np.square(kernel @ self.factor[d].T).sum(axis=1)
        return value, slope, np.maximum(spread, 0.0, out=spread)

    def predict_one(self, x: Array) -> tuple[Array, Array, Array]:
        """At one x (M,) rad: mean (D,) · Jacobian (D,M) per rad · variance (D,)."""
        kernel, value, slope = self._at(x)
        projected = np.matmul(self.factor, kernel[:, :, None])[:, :, 0]
        spread = self.amplitude - np.einsum("dn,dn->d", projected, projected)
        return value, slope, np.maximum(spread, 0.0)

    def mean_one(self, x: Array) -> tuple[Array, Array]:
        """At one x (M,) rad: mean (D,) · Jacobian (D,M) per rad; the short way."""
        return self._at(x)[1:]

    def means(self, x: Array) -> tuple[Array, Array]:
        """At x (N,M) rad: mean (N,D) · Jacobian (N,D,M) per rad, without the variance: O(N n)."""
        value, slope = np.empty((len(x), len(self.mean))), np.empty((len(x), *self.scales.shape))
        for d, rows, kernel in self._kernels(x):
            value[rows, d], slope[rows, d] = self._linear(d, x[rows], kernel)
        return value, slope

    def covariance(self, x: Array) -> Array:
        """Between all pairs of x (N,M) rad: (D,N,N) unit²; model error is systematic, this says how far along."""
        result = np.empty((len(self.mean), len(x), len(x)))
        for d, scales in enumerate(self.scales):
            kernel = se(x / scales, self.centres / scales, self.amplitude[d])
            projected = kernel @ self.factor[d].T
            result[d] = se(x / scales, x / scales, self.amplitude[d]) - projected @ projected.T
        return result

    def slope_variance(self, x: Array) -> Array:
        """Variance of the Jacobian at x (N,M) rad: (N,D,M) per rad squared."""
        result = np.empty((len(x), *self.scales.shape))
        for d, rows, kernel in self._kernels(x):
            for m, scale in enumerate(self.scales[d]):
                lean = kernel * (self.centres[:, m] - x[rows, m, None]) / scale**2
                result[rows, d, m] = self.amplitude[d] / scale**2 - np.square(lean @ self.factor[d].T).sum(axis=1)
        return np.maximum(result, 0.0, out=result)

    def _at(self, x: Array) -> tuple[Array, Array, Array]:
        lifted = self._lifted.copy()
        lifted[:-1] += x[:, None]
        kernel = np.exp(self._exponent @ (lifted * lifted))
        sums = (kernel * self.weights) @ lifted.T
        return kernel, sums[:, -1] + self.mean, sums[:, :-1] * self._minus_precision

    def _linear(self, d: int, x: Array, kernel: Array) -> tuple[Array, Array]:
        # dk/dx = −k (x − z)/l²: both sums over centres in one product
        sums = kernel @ self._moments[d]
        lean = (x - self._origin) * sums[:, :1] - sums[:, 1:]
        return sums[:, 0] + self.mean[d], lean * self._minus_precision[d]

    def _kernels(self, x: Array) -> Iterator[tuple[int, slice, Array]]:
        step = max(1, _BLOCK_BYTES // (8 * len(self.centres)))
        for start in range(0, len(x), step):
            rows = slice(start, min(start + step, len(x)))
            for d, scales in enumerate(self.scales):
                near, far = (x[rows] - self._origin) / scales, (self.centres - self._origin) / scales
                yield d, rows, se(near, far, self.amplitude[d])

    @cached_property
    def _origin(self) -> Array:
        return np.asarray(self.centres.mean(axis=0))

    @cached_property
    def _moments(self) -> Array:
        lifted = np.column_stack([np.ones(len(self.centres)), self.centres - self._origin])
        return np.asarray(self.weights[:, :, None] * lifted)

    @cached_property
    def _lifted(self) -> Array:
        return np.asarray(np.vstack([-self.centres.T, np.ones(len(self.centres))]))

    @cached_property
    def _exponent(self) -> Array:
        return np.asarray(np.column_stack([-0.5 / self.scales**2, np.log(self.amplitude)]))

    @cached_property
    def _minus_precision(self) -> Array:
        return np.asarray(-1.0 / self.scales**2)


def se(a: Array, b: Array, amplitude: float) -> Array:
    """Squared-exponential kernel between a (N,M) and b (n,M), both divided by their length scales: (N,n)."""
    half_a, half_b = np.square(a).sum(axis=1), np.square(b).sum(axis=1)
    left = np.column_stack([a, np.full(len(a), 1.0), -0.5 * half_a])
    right = np.column_stack([b, -0.5 * half_b, np.full(len(b), 1.0)])
    exponent = left @ right.T
    np.minimum(exponent, 0.0, out=exponent)
    np.exp(exponent, out=exponent)
    exponent *= amplitude
    return np.asarray(exponent)
