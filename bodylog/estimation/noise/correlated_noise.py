"""Common errors of neighbouring frames, and how much less these count for it.

The model's error depends on the posture, and perception's on the place within a pixel. Frames from
nearly the same place share an error E (px²), and a belief must not be surer than that. With motion
of order n, its noise of density q (px² / s^(2n−1)) in the image, and readings with noise of density
R (px² s), a filter, whose poles are those of a Butterworth filter, has the variance c R^(1−1/2n)
q^(1/2n), c = 1 / sin(π/2n), and a smoother 1/2n of it. This equals E if correlated frames within a
span of (E / c²ⁿ q)^(1/(2n−1)) s count as one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np

from ...body_model import ForwardModel
from ...types import Array
from ..measurements.records import mix_rows

Number = TypeVar("Number", float, Array)

PIXEL_CORRELATION_PX = 0.5
"""px: correlation length of perception's error, which has the period of the pixels."""
INTERPOLATED_WEIGHT = 0.5
"""Weight of a lasting error in a smoother beyond that of an independent one. Interpolated between
two frames, (1 − x) e₀ + x e₁, a lasting error keeps its variance, and independent ones get the mean
of (1 − x)² + x², 2/3 of theirs: the lasting one weighs 3/2 as much.
"""
EXTRAPOLATED_WEIGHT = -0.5
"""Weight of a lasting error in a filter beyond that of an
independent one, on average over the time to the next frame.

Extrapolated from two frames independent errors get 8/3 of their variance,
from three on a line 3/2: −5/8 and −1/3. Of these and −1/2, tried on 40
drawn explorations and reaches, NEES is nearest to 1 with −1/2.
"""


def compute_steady_variance(density: Array, process: Array, order: int) -> Array:
    """Variance (M,) rad² of the filtered angle, for
    readings of density R (M,) rad² s and process q (M,).
    """
    power = 1.0 / (2 * order)
    return np.asarray(density ** (1.0 - power) * process**power / np.sin(np.pi * power))


@dataclass(frozen=True, eq=False)
class ErrorCorrelation:
    """When a track's errors correlate: postures within
    reach (M,) rad, places within `near` px, 0 for never.

    process (M,) rad²/s³: the joints' white acceleration, or jerk, rad²/s⁵, for order 3 · whole: for
    a smoother, by the frames of the whole log.
    """

    process: Array
    reach: Array
    correlation_px: float
    whole: bool = False
    order: int = 2

    @cached_property
    def scaled_process(self) -> Array:
        """Process variance (M,) times c²ⁿ."""
        steady = compute_steady_variance(np.ones(()), np.ones(()), self.order)
        if self.whole:
            steady = steady / (2 * self.order)
        return np.asarray(steady ** (2 * self.order) * self.process)

    @property
    def span_exponent(self) -> float:
        """Power of error over process variance that a span is."""
        return 1.0 / (2 * self.order - 1)

    def correlate_posture_steps(self, step: Array) -> Array:
        """Correlation (…,) of the model's errors for a step (…,M) rad of the joints."""
        return np.asarray(np.exp(-0.5 * np.square(step / self.reach).sum(axis=-1)))

    def correlate_place_steps(self, step: Array) -> Array:
        """Correlation (…,) of perception's errors for a step (…,D) px."""
        if self.correlation_px <= 0:
            return np.zeros(step.shape[:-1])
        return np.asarray(np.exp(-np.sqrt(np.square(step).sum(axis=-1)) / self.correlation_px))

    def compute_kept_share(self, dt: Array, lasting: Array, jac: Array) -> Array:
        """Share κ (F,) of frames dt (F,) s before that still
        counts, for common variances `lasting` (F,D) px².

        (1 + κ) / (1 − κ) is span/dt for much shorter dt.
        """
        error = np.einsum("fd->f", lasting)
        drift = np.einsum("fdm,m->f", np.square(jac), self.scaled_process)
        span = (error / np.maximum(drift, 1e-9)) ** self.span_exponent
        return np.asarray(np.exp(-2.0 * dt / np.maximum(span, 1e-9)))

    def compute_variance_factor(self, count: Number, similarity: Number) -> Number:
        """Factor on the variance of a frame that counts as
        one of `count`; similarity: correlation with the last.

        A lasting error keeps its variance.
        """
        weight = INTERPOLATED_WEIGHT if self.whole else EXTRAPOLATED_WEIGHT
        return 2.0 * count - 1.0 + weight * similarity / count


def read_correlation_length(model: ForwardModel) -> Array:
    """Correlation length (M,) or () rad of the model's errors; infinite if the model has none."""
    return np.asarray(getattr(model, "reach", np.inf))


def correlate_postures(model: ForwardModel, x: Array) -> Array:
    """Correlation (F,F) of the model's errors at angles x (F,M) rad, by its own covariance; 1
    where it has none.

    `read_correlation_length` is a mean over postures: beyond what a body was learned from, errors
    last for much longer steps than beside it.
    """
    covariance = getattr(model, "covariance", None)
    if covariance is None:
        return np.ones((len(x), len(x)))
    shared = covariance(x).mean(axis=0)
    std = np.sqrt(np.maximum(np.diag(shared), np.finfo(float).tiny))
    most = np.outer(std, std)
    return np.asarray(np.clip(shared, -most, most) / most)


def inflate_variances(
    like: ErrorCorrelation,
    t: Array,
    places: Array,
    points: Array,
    jac: Array,
    pixel: Array,
    model: Array,
    duplication: float = 1.0,
) -> Array:
    """Variances (F,D) px² of frames at t (F,) s, inflated
    such that correlated frames do not count too much.

    places (F,D) px · points (F,M) rad and jac (F,D,M) there · pixel and model variance (F,D) ·
    duplication: factor on the model's.
    """
    if not len(t):
        return pixel + model
    by_place = like.correlate_place_steps(np.diff(places, axis=0))
    by_posture = like.correlate_posture_steps(np.diff(points, axis=0))
    lasting = pixel[1:] * by_place[:, None] + model[1:] * by_posture[:, None]
    kept = like.compute_kept_share(np.diff(t), lasting, jac[1:])
    spots, postures = (
        like.compute_variance_factor(count_effective_frames(kept * one), np.append(0.0, one))
        for one in (by_place, by_posture)
    )
    return np.asarray(pixel * spots[:, None] + duplication * model * postures[:, None])


def compute_shared_model_factors(
    frames: Sequence[int], common: Sequence[float], distinct: float
) -> tuple[float, ...]:
    """Factor on each track's model variance, for the
    share of it in common with other tracks' models.

    frames: number of each track's frames · distinct: directions of joints that their rows
    determine. Rows with a common error count as often as there are more of them than directions.
    Without a direction (0) they count once.
    """
    rows = 2.0 * sum(count for count, share in zip(frames, common, strict=True) if share > 0)
    return tuple(
        1.0 + share * (max(rows / (distinct * max(count, 1)), 1.0) - 1.0)
        if share > 0 and distinct
        else 1.0
        for count, share in zip(frames, common, strict=True)
    )


def count_directions(models: Sequence[ForwardModel], x: Array) -> int:
    """Rank of the stacked Jacobians of all models at x (M,)."""
    return int(
        np.linalg.matrix_rank(np.concatenate([model.predict(x[None])[1][0] for model in models]))
    )


def count_effective_frames(kept: Array) -> Array:
    """Number of frames (F,) up to each that count as one,
    n[k] = 1 + kept[k] n[k−1], for shares kept (F−1,).

    At a steady rate n is 1 / (1 − kept). A mean over many frames with
    correlation kept from one to the next has the variance of independent
    ones with (1 + kept) / (1 − kept) = 2n − 1 times their variance.
    """
    count = np.ones(len(kept) + 1)
    kept = np.append(0.0, kept)
    reach = 1
    # by doubling: after each round the sums reach twice as far back
    while reach < len(count) and kept.any():
        count[reach:] += kept[reach:] * count[:-reach]
        kept[reach:] *= kept[:-reach].copy()
        reach *= 2
    return count


@dataclass(frozen=True, eq=False)
class LastFrame:
    """Last frame of a track: time (s), place (D,) px, angles (M,); its counts (2,)."""

    t: float = -np.inf
    place: Array | None = None
    point: Array | None = None
    count: Array = field(default_factory=lambda: np.zeros(2))


@dataclass(frozen=True, eq=False)
class PendingFrame:
    """One frame of a track at t (s): model, value (D,),
    its variance (D,), error correlation, last frame.

    mix (D,D): makes these independent rows from the model's, as in `Rows`; None for 1.
    """

    model: ForwardModel
    t: float
    value: Array
    var: Array
    like: ErrorCorrelation
    memory: LastFrame
    mix: Array | None = None

    def predict(self, x: Array) -> tuple[Array, Array, Array]:
        """Mean (N,D), Jacobian (N,D,M) and model variance (N,D) at angles x (N,M)."""
        return mix_rows(self.mix, self.model.predict(x))

    def predict_single(self, x: Array) -> tuple[Array, Array, Array]:
        """Mean (D,), Jacobian (D,M) and model variance (D,) at angles x (M,)."""
        one = getattr(self.model, "predict_one", None)
        if one is not None and self.mix is None:
            return one(x)  # type: ignore[no-any-return]
        mean, jac, model = self.predict(x[None])
        return mean[0], jac[0], model[0]

    def predict_inflated(self, x: Array) -> tuple[Array, Array, Array, Array, LastFrame]:
        """Mean (D,), Jacobian (D,M), model variance (D,), total one as in `inflate_variances`,
        memory, at angles x (M,).
        """
        mean, jac, model = self.predict_single(x)
        spots, postures, memory = self._compute_inflation(x, jac, model)
        return mean, jac, model, self.var * spots + model * postures, memory

    def _compute_inflation(
        self, x: Array, jac: Array, model: Array
    ) -> tuple[float, float, LastFrame]:
        """Factors on perception's and the model's variance, and the memory afterwards."""
        last = self.memory
        like = self.like
        if last.place is None or last.point is None:
            return 1.0, 1.0, LastFrame(self.t, self.value, x, np.ones(2))
        step = (self.value - last.place).tolist()
        away = ((x - last.point) / like.reach).tolist()
        spot = (
            math.exp(-math.hypot(*step) / like.correlation_px) if like.correlation_px > 0 else 0.0
        )
        posture = math.exp(-0.5 * math.hypot(*away) ** 2)
        # a sum of so few numbers takes NumPy 2 µs, and Python 0.3
        error = spot * sum(self.var.tolist()) + posture * sum(model.tolist())
        drift = sum((np.square(jac) @ like.scaled_process).tolist())
        span = max((error / max(drift, 1e-9)) ** like.span_exponent, 1e-9)
        fade = math.exp(-2.0 * (self.t - last.t) / span)
        by_spot, by_posture = last.count.tolist()
        by_spot = 1.0 + fade * spot * by_spot
        by_posture = 1.0 + fade * posture * by_posture
        spots = like.compute_variance_factor(by_spot, spot)
        postures = like.compute_variance_factor(by_posture, posture)
        return spots, postures, LastFrame(self.t, self.value, x, np.array([by_spot, by_posture]))
