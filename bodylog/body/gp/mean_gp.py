"""A Gaussian process on what a mean with linear unknowns leaves of a sense."""

from abc import abstractmethod
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import numpy as np

from ...types import Array
from .model import GP, se_kernel

_ROWS = 2048
_STEP = 1e-4

MeanAt = tuple[Array, Array, Array]
"""At N postures or at one: what the mean predicts (N,D) · its slope (N,D,M) by the joints · its
design (N,D,P) by the unknowns."""


@dataclass(frozen=True, eq=False)
class MeanGP(GP):
    """The fields of GP are those of the residual, whose mean is zero.

    root (P,p): the covariance of the mean's unknowns is root rootᵀ · lean (D,p,n): weights with
    which the samples predict root's columns · drift (D,) px²: variance of an error that outlasts a
    log.
    """

    root: Array
    lean: Array
    drift: Array

    @classmethod
    def on(cls, plain: GP, **unknowns: Any) -> Self:
        """Build the model on a residual process `plain`."""
        residual: dict[str, Any] = {field.name: getattr(plain, field.name) for field in fields(GP)}
        return cls(**residual, **unknowns)

    @abstractmethod
    def _evaluate_mean(self, x: Array) -> MeanAt:
        """The mean at x (N,M) rad."""

    @abstractmethod
    def _evaluate_mean_once(self, x: Array) -> MeanAt:
        """The mean at one x (M,) rad: (D,), (D,M) and (D,P)."""

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at x (N,M) rad: mean (N,D) · Jacobian (N,D,M)
        per rad · variance (N,D), sensor noise excluded.
        """
        x = np.atleast_2d(x)
        if len(x) == 1:
            one = self.predict_one(x[0])
            return one[0][None], one[1][None], one[2][None]
        if len(x) > _ROWS:
            parts = [self.predict(x[start : start + _ROWS]) for start in range(0, len(x), _ROWS)]
            value, slope, spread = (np.concatenate(column) for column in zip(*parts, strict=True))
            return value, slope, spread
        value, slope, spread = super().predict(x)
        image, by_joints, design = self._evaluate_mean(x)
        unknown = np.square(self._compute_unknown_effects(x, design)).sum(axis=2)
        return value + image, slope + by_joints, spread + unknown + self.drift

    def predict_one(self, x: Array) -> tuple[Array, Array, Array]:
        """Predict at one x (M,) rad: mean (D,) · Jacobian (D,M) per rad · variance (D,)."""
        single = self._singles[0]
        image, by_joints, design = self._evaluate_mean_once(x)
        kernel, tilt = single.kernel(x - self._origin)
        sums = self._rows.dot(kernel)
        own = len(single.rows)
        value, slope, spread = single.evaluate(sums[:own], tilt)
        unknown = design.dot(self.root)
        unknown -= sums[own:].reshape(unknown.shape)
        spread = spread + self.drift
        spread += np.einsum("dp,dp->d", unknown, unknown)
        return value + image, slope + by_joints, spread

    def means(self, x: Array) -> tuple[Array, Array]:
        """Predict at x (N,M) rad: mean (N,D) · Jacobian (N,D,M) per rad, without the variance."""
        value, slope = super().means(x)
        image, by_joints, _ = self._evaluate_mean(x)
        return value + image, slope + by_joints

    def design(self, x: Array) -> Array:
        """Derivative of the mean by its unknowns at x (N,M) rad: (N,D,P) px per unit of them."""
        return np.asarray(self._evaluate_mean(np.atleast_2d(x))[2])

    def unknowns(self, x: Array) -> Array:
        """Effect (N,D,p), px, of one standard deviation of
        each direction of the unknowns at x (N,M) rad, given the samples.
        """
        return self._compute_unknown_effects(x, self._evaluate_mean(x)[2])

    def covariance(self, x: Array) -> Array:
        """Covariance between all pairs of x (N,M) rad: (1,N,N) px², the outputs' mean."""
        leaning = (
            self._compute_unknown_effects(x, self._evaluate_mean(x)[2])
            / np.sqrt(self.share)[:, None]
        )
        return np.asarray(
            super().covariance(x)
            + np.einsum("ndp,kdp->nk", leaning, leaning)[None] / len(self.share)
        )

    def slope_variance(self, x: Array) -> Array:
        """Variance of the Jacobian at x (N,M) rad: (N,D,M) per rad squared."""
        result = super().slope_variance(x)
        for m in range(x.shape[1]):
            step = _STEP * np.eye(x.shape[1])[m]
            above, below = (self.unknowns(x + way) for way in (step, -step))
            result[..., m] += np.square((above - below) / (2.0 * _STEP)).sum(axis=2)
        return result

    @cached_property
    def _rows(self) -> Array:
        """The process's rows and below them lean's (D p,n), of a kernel of amplitude 1."""
        leaning = self.lean.reshape(-1, self.lean.shape[2]) * self.amplitude[0]
        return np.asfortranarray(np.concatenate([self._singles[0].rows, leaning]))

    def _compute_unknown_effects(self, x: Array, design: Array) -> Array:
        """Effect (N,D,p), px, of one standard deviation
        of each direction of the unknowns, given the samples.
        """
        scales = self.scales[0]
        kernel = se_kernel(x / scales, self.centres / scales, self.amplitude[0])
        return np.asarray(design @ self.root - np.einsum("nk,dpk->ndp", kernel, self.lean))
