"""Gaussian-process forward model: mean, Jacobian and variance at one point or at many (paper, "Body learning")."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from ..types import Array

_BLOCK_BYTES = 4 << 20
_STRIP = 128


@dataclass(frozen=True, eq=False)
class GP:
    """One sense's learned model: D outputs on shared centres, one squared-exponential kernel (G=1) or one each (G=D).

    outputs (D,) names · unit of the outputs · centres (n,M) rad · scales (G,M) rad · amplitude (G,) unit² ·
    mean (D,) unit · weights (D,n) · lower factor (G,n,n): variance = amplitude − |factor k|² · noise (D,) unit² found
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
        value, slope, spread = self._empty(len(x))
        for group, rows, kernel in self._kernels(x):
            self._linear(group, x[rows], kernel, value[rows], slope[rows])
            left = self.amplitude[group] - np.square(self._projected(group, kernel)).sum(axis=-1)
            spread[rows, self._members(group)] = np.maximum(left, 0.0)[:, None]
        return value, slope, spread

    def predict_one(self, x: Array) -> tuple[Array, Array, Array]:
        """At one x (M,) rad: mean (D,) · Jacobian (D,M) per rad · variance (D,)."""
        kernel, value, slope = self._at(x)
        seen = [_times(upper, row) for upper, row in zip(self._uppers, kernel, strict=True)]
        left = [max(a - float(part @ part), 0.0) for a, part in zip(self._amplitudes, seen, strict=True)]
        return value, slope, np.array(left * len(value) if len(left) == 1 else left)

    def mean_one(self, x: Array) -> tuple[Array, Array]:
        """At one x (M,) rad: mean (D,) · Jacobian (D,M) per rad; the short way."""
        return self._at(x)[1:]

    def means(self, x: Array) -> tuple[Array, Array]:
        """At x (N,M) rad: mean (N,D) · Jacobian (N,D,M) per rad, without the variance: O(N n)."""
        value, slope, _ = self._empty(len(x))
        for group, rows, kernel in self._kernels(x):
            self._linear(group, x[rows], kernel, value[rows], slope[rows])
        return value, slope

    def covariance(self, x: Array) -> Array:
        """Between all pairs of x (N,M) rad: (G,N,N) unit²; model error is systematic, this says how far along."""
        result = np.empty((len(self.scales), len(x), len(x)))
        for group, scales in enumerate(self.scales):
            kernel = se(x / scales, self.centres / scales, self.amplitude[group])
            projected = self._projected(group, kernel)
            result[group] = se(x / scales, x / scales, self.amplitude[group]) - projected @ projected.T
        return result

    def slope_variance(self, x: Array) -> Array:
        """Variance of the Jacobian at x (N,M) rad: (N,D,M) per rad squared."""
        result = self._empty(len(x))[1]
        for group, rows, kernel in self._kernels(x):
            for m, scale in enumerate(self.scales[group]):
                lean = kernel * (self.centres[:, m] - x[rows, m, None]) / scale**2
                left = self.amplitude[group] / scale**2 - np.square(self._projected(group, lean)).sum(axis=-1)
                result[rows, self._members(group), m] = np.maximum(left, 0.0)[:, None]
        return result

    def _at(self, x: Array) -> tuple[Array, Array, Array]:
        lifted = self._lifted.copy()
        lifted[:-1] += x[:, None]
        kernel = np.exp(self._exponent @ (lifted * lifted))
        sums = (kernel * self.weights) @ lifted.T
        return kernel, sums[:, -1] + self.mean, sums[:, :-1] * self._minus_precision

    def _projected(self, group: int, kernel: Array) -> Array:
        """factor · k for kernel (N,n); zeros above the diagonal are passed over in strips."""
        factor, count = self.factor[group], kernel.shape[1]
        strips = [(start, min(start + _STRIP, count)) for start in range(0, count, _STRIP)]
        return np.concatenate([kernel[:, :stop] @ factor[start:stop, :stop].T for start, stop in strips], axis=1)

    def _linear(self, group: int, x: Array, kernel: Array, value: Array, slope: Array) -> None:
        """Fill value (N,D) and slope (N,D,M) of the group's outputs: dk/dx = −k (x − z)/l², sums over centres."""
        for d in self._members(group):
            sums = kernel @ self._moments[d]
            value[:, d] = sums[:, 0] + self.mean[d]
            slope[:, d] = ((x - self._origin) * sums[:, :1] - sums[:, 1:]) * self._minus_precision[group]

    def _members(self, group: int) -> list[int]:
        return list(range(len(self.mean))) if len(self.scales) == 1 else [group]

    def _empty(self, count: int) -> tuple[Array, Array, Array]:
        shape = count, len(self.mean)
        return np.empty(shape), np.empty((*shape, self.scales.shape[1])), np.empty(shape)

    def _kernels(self, x: Array) -> Iterator[tuple[int, slice, Array]]:
        step = max(1, _BLOCK_BYTES // (8 * len(self.centres)))
        for start in range(0, len(x), step):
            rows = slice(start, min(start + step, len(x)))
            for group, scales in enumerate(self.scales):
                near, far = (x[rows] - self._origin) / scales, (self.centres - self._origin) / scales
                yield group, rows, se(near, far, self.amplitude[group])

    @cached_property
    def _origin(self) -> Array:
        return np.asarray(self.centres.mean(axis=0))

    @cached_property
    def _moments(self) -> Array:
        lifted = np.column_stack([np.ones(len(self.centres)), self.centres - self._origin])
        return np.asarray(self.weights[:, :, None] * lifted)

    @cached_property
    def _uppers(self) -> list[Array]:
        return [lower.T for lower in self.factor]

    @cached_property
    def _amplitudes(self) -> list[float]:
        return [float(a) for a in self.amplitude]

    @cached_property
    def _lifted(self) -> Array:
        return np.asarray(np.vstack([-self.centres.T, np.ones(len(self.centres))]))

    @cached_property
    def _exponent(self) -> Array:
        return np.asarray(np.column_stack([-0.5 / self.scales**2, np.log(self.amplitude)]))

    @cached_property
    def _minus_precision(self) -> Array:
        return np.asarray(-1.0 / self.scales**2)


def _times(upper: Array, vector: Array) -> Array:
    """upperᵀ (n,n) · vector (n,), reading only the triangle once it no longer fits the nearest cache."""
    if len(vector) <= _STRIP:
        return np.asarray(vector @ upper)
    return np.asarray(_dtrmv()(upper, vector, trans=1))


@cache
def _dtrmv() -> Any:
    from scipy.linalg.blas import dtrmv

    return dtrmv


def se(a: Array, b: Array, amplitude: float) -> Array:
    """Squared-exponential kernel between a (N,M) and b (n,M), both divided by their length scales: (N,n)."""
    half_a, half_b = np.square(a).sum(axis=1), np.square(b).sum(axis=1)
    left, right = (np.ones((len(part), part.shape[1] + 2)) for part in (a, b))
    left[:, :-2], left[:, -1] = a, -0.5 * half_a
    right[:, :-2], right[:, -2] = b, -0.5 * half_b
    exponent = left @ right.T
    np.minimum(exponent, 0.0, out=exponent)
    np.exp(exponent, out=exponent)
    exponent *= amplitude
    return np.asarray(exponent)
