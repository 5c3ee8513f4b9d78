"""What neighbouring frames err in common, and how much less they say for it.

The model's error goes with the posture, perception's with where among the pixels a thing lies: frames from nearly the
same place err alike, and a belief is to be no surer than that common error E (px²). Where joints move with white
acceleration, q (px²/s³) as pictures see it, a filter that hears noise of density R (px² s) comes to the variance
√2 R^¾ q^¼, a smoother to R^¾ q^¼ / 2√2. That is E when alike frames within (E/4q)^⅓ s, or 4(E/q)^⅓ s, count as one,
and a share s of it is E when that is s^(−4/3) times as long.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...body_model import ForwardModel
from ...types import Array

NEAR = 0.5
"""px: places closer than this share perception's error, which has the period of the pixels."""
PAST, WHOLE = 4.0, 1.0 / 64.0
"""Share of q in the span within which frames count as one: of a belief by the past alone, or by the whole log."""
LASTING = {PAST: -5.0 / 8.0, WHOLE: 1.0 / 2.0}
"""What more a lasting error counts than one that every frame has anew, on average from one frame to the next.

Extrapolated from two frames, (1 + x) e₁ − x e₀, it is what it was, and new ones come to 8/3 of their variance;
interpolated, (1 − x) e₀ + x e₁, to 2/3.
"""


@dataclass(frozen=True, eq=False)
class ErrorCorrelation:
    """When frames of a track err alike: postures within reach (M,) rad, places within `near` px, 0 where never.

    process (M,) rad²/s³: the joints' white acceleration · share: PAST or WHOLE · stated () or (M,): what share of the
    variance a belief comes to is stated, which is to be the common error.
    """

    process: Array
    reach: Array
    near: float
    share: float
    stated: Array | float = 1.0

    @cached_property
    def wander(self) -> Array:
        """The joints' white acceleration that counts (M,), rad²/s³."""
        return np.asarray(self.stated**4 * self.share * self.process)

    def postures(self, step: Array) -> Array:
        """How alike (…,) the model errs, joints being a step (…,M) rad apart."""
        return np.asarray(np.exp(-0.5 * np.square(step / self.reach).sum(axis=-1)))

    def spots(self, step: Array) -> Array:
        """How alike (…,) perception errs, places being a step (…,D) px apart."""
        return np.asarray((self.near > 0) * np.exp(-np.sqrt(np.square(step).sum(axis=-1)) / (self.near or 1.0)))

    def fade(self, dt: Array, lasting: Array, jac: Array) -> Array:
        """Share κ (F,) of frames dt (F,) s ago that still counts, of variance `lasting` (F,D) px² in common.

        (1 + κ) / (1 − κ) is span/dt, dt much shorter.
        """
        error = np.einsum("fd->f", lasting)
        drift = np.einsum("fdm,m->f", np.square(jac), self.wander)
        span = np.cbrt(error / np.maximum(drift, 1e-9))
        return np.asarray(np.exp(-2.0 * dt / np.maximum(span, 1e-9)))

    def times(self, count: Array, like: Array) -> Array:
        """How many times its variance a frame has that amounts to `count`, the last having erred alike by `like`."""
        return np.asarray(2.0 * count - 1.0 + LASTING[self.share] * like / count)


def reach(model: ForwardModel) -> Array:
    """Angles (M,) or () rad that are to part before the model errs otherwise; where it does not say, it never does."""
    return np.asarray(getattr(model, "reach", np.inf))


def variances(
    like: ErrorCorrelation, t: Array, places: Array, points: Array, jac: Array, pixel: Array, model: Array,
    often: float = 1.0,
) -> Array:  # fmt: skip
    """Variances (F,D) px² of frames seen at t (F,) s, such that alike ones together say no more than they know.

    places (F,D) px · points (F,M) rad and jac (F,D,M) there · pixel and model variance (F,D), this to count so `often`.
    """
    if not len(t):
        return pixel + model
    similarity = like.spots(np.diff(places, axis=0)), like.postures(np.diff(points, axis=0))
    lasting = pixel[1:] * similarity[0][:, None] + model[1:] * similarity[1][:, None]
    fade = like.fade(np.diff(t), lasting, jac[1:])
    spots, postures = (like.times(counts(fade * one), np.append(0.0, one))[:, None] for one in similarity)
    return np.asarray(pixel * spots + often * model * postures)


def repeated(frames: Sequence[int], common: Sequence[float], distinct: float) -> tuple[float, ...]:
    """How many times its model's variance E each track counts with, of what share in common with other tracks' models.

    frames: how many each was seen in · told: directions of joints that their rows tell apart, in which the error lies:
    rows that are taken to err each by itself say as many times what they know as there are more of them.
    Rows that tell no direction apart (told 0) count once.
    """
    rows = 2.0 * sum(count for count, share in zip(frames, common, strict=True) if share > 0)
    return tuple(
        1.0 + share * (max(rows / (distinct * max(count, 1)), 1.0) - 1.0) if share > 0 and distinct else 1.0
        for count, share in zip(frames, common, strict=True)
    )


def directions(models: Sequence[ForwardModel], x: Array) -> int:
    """How many directions of joints all rows of the models' Jacobians span at x (M,)."""
    return int(np.linalg.matrix_rank(np.concatenate([model.predict(x[None])[1][0] for model in models])))


def counts(kept: Array) -> Array:
    """How many frames (F,) up to each count as one, n[k] = 1 + kept[k] n[k−1], of the shares kept (F−1,).

    At a steady pace n is 1 / (1 − kept), and a mean over many frames, whose errors correlate by that from one to the
    next, has the variance of as many independent ones with (1 + kept) / (1 − kept) = 2n − 1 times their variance.
    """
    count, kept, reach = np.ones(len(kept) + 1), np.append(0.0, kept), 1
    # by doubling: after each round the sums reach twice as far back
    while reach < len(count) and kept.any():
        count[reach:] += kept[reach:] * count[:-reach]
        kept[reach:] *= kept[:-reach].copy()
        reach *= 2
    return count


@dataclass(frozen=True, eq=False)
class LastFrame:
    """When (s), where (D,) px and from which angles (M,) a track was last seen; how many of these count (2,)."""

    t: float = -np.inf
    place: Array | None = None
    point: Array | None = None
    count: Array = field(default_factory=lambda: np.zeros(2))


@dataclass(frozen=True, eq=False)
class PendingFrame:
    """One track seen at an instant t (s): model, value (D,), its variance (D,), what errs alike, memory.

    cov (D,D): where the rows err together, with `var` its diagonal; None where each errs by itself.
    """

    model: ForwardModel
    t: float
    value: Array
    var: Array
    like: ErrorCorrelation
    memory: LastFrame
    cov: Array | None = None

    def predicted(self, x: Array) -> tuple[Array, Array, Array]:
        """At angles x (M,): mean (D,), Jacobian (D,M) and the model's variance (D,)."""
        one = getattr(self.model, "predict_one", None)
        if one is not None:
            return one(x)  # type: ignore[no-any-return]
        mean, jac, model = self.model.predict(x[None])
        return mean[0], jac[0], model[0]

    def at(self, x: Array) -> tuple[Array, Array, Array, Array, LastFrame]:
        """At angles x (M,): mean (D,), Jacobian (D,M), model variance (D,), the whole as `variances` has it, memory.

        The whole is a covariance (D,D) where rows err together.
        """
        mean, jac, model = self.predicted(x)
        spots, postures, memory = self._inflation(x, jac, model)
        var = self.var * spots + model * postures
        if self.cov is not None:
            var = self.cov * spots + np.diag(model * postures)
        return mean, jac, model, var, memory

    def _inflation(self, x: Array, jac: Array, model: Array) -> tuple[float, float, LastFrame]:
        """How many times perception's and the model's variance count, and what is remembered then."""
        last, like, share = self.memory, self.like, LASTING[self.like.share]
        if last.place is None or last.point is None:
            return 1.0, 1.0, LastFrame(self.t, self.value, x, np.ones(2))
        step, away = (self.value - last.place).tolist(), ((x - last.point) / like.reach).tolist()
        spot = math.exp(-math.hypot(*step) / like.near) if like.near > 0 else 0.0
        posture = math.exp(-0.5 * math.hypot(*away) ** 2)
        error = spot * float(self.var.sum()) + posture * float(model.sum())
        drift = float((np.square(jac) @ like.wander).sum())
        span = max((error / max(drift, 1e-9)) ** (1.0 / 3.0), 1e-9)
        fade = math.exp(-2.0 * (self.t - last.t) / span)
        by_spot, by_posture = last.count.tolist()
        counts = 1.0 + fade * spot * by_spot, 1.0 + fade * posture * by_posture
        spots, postures = (
            2.0 * count - 1.0 + share * similarity / count
            for count, similarity in zip(counts, (spot, posture), strict=True)
        )
        return spots, postures, LastFrame(self.t, self.value, x, np.array(counts))
