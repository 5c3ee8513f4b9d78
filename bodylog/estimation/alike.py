"""What neighbouring frames err in common, and how much less they say for it.

The model's error goes with the posture, perception's with where among the pixels a thing lies: frames from nearly the
same place err alike, and a belief is to be no surer than that common error E (px²). Where joints move with white
acceleration, q (px²/s³) as pictures see it, a filter that hears noise of density R (px² s) comes to the variance
√2 R^¾ q^¼, a smoother to R^¾ q^¼ / 2√2. That is E when alike frames within (E/4q)^⅓ s, or 4(E/q)^⅓ s, count as one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array, ForwardModel

ALIKE = 0.01
"""rad: angles closer than this share the model's error."""
NEAR = 0.5
"""px: places closer than this share perception's error, which has the period of the pixels."""
PAST, WHOLE = 4.0, 1.0 / 64.0
"""Share of q in the span within which frames count as one: of a belief by the past alone, or by the whole log."""


def variances(
    t: Array, places: Array, points: Array, jac: Array, pixel: Array, model: Array, pace: Array, near: float
) -> Array:  # fmt: skip
    """Variances (F,D) px² of frames seen at t (F,) s, such that alike ones together say no more than they know.

    places (F,D) px · points (F,M) rad and jac (F,D,M) there · pixel and model variance (F,D) · pace (M,) rad²/s³: the
    white acceleration times PAST or WHOLE · near: px within which pixels err alike, 0 where they never do.
    """
    if not len(t):
        return pixel + model
    fade = _faded(np.diff(t), _span(model + pixel * (near > 0), jac, pace)[1:])
    postures = counts(fade * np.exp(-_apart(points) / ALIKE))
    spots = counts(fade * np.exp(-_apart(places) / near)) if near else postures**0.0
    return np.asarray(pixel * (2.0 * spots - 1.0)[:, None] + model * (2.0 * postures - 1.0)[:, None])


def repeated(frames: Sequence[int], common: Sequence[float]) -> tuple[float, ...]:
    """How many times its model's variance E each track counts with, of what share in common with other tracks' models.

    T tracks as surely seen then leave c E + (1 − c) E / T between them. frames: how many each was seen in.
    """
    whole = sum(count for count, share in zip(frames, common, strict=True) if share > 0)
    return tuple(
        1.0 + share * (whole / max(count, 1) - 1.0) if share > 0 else 1.0
        for count, share in zip(frames, common, strict=True)
    )


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


def _apart(rows: Array) -> Array:
    """Distance (F−1,) from each row (F,D) to the next."""
    step = np.diff(rows, axis=0)
    return np.asarray(np.sqrt(np.einsum("fd,fd->f", step, step)))


def _span(error: Array, jac: Array, pace: Array) -> Array:
    """Seconds (F,) within which frames count as one."""
    drift = np.einsum("fdm,m->f", np.square(jac), pace)
    return np.asarray(np.cbrt(np.einsum("fd->f", error) / np.maximum(drift, 1e-9)))


def _faded(dt: Array, span: Array) -> Array:
    """Share of earlier frames that still counts; (1 + κ) / (1 − κ) is span/dt for frames dt apart, dt much shorter."""
    return np.asarray(np.exp(-2.0 * dt / np.maximum(span, 1e-9)))


@dataclass(frozen=True, eq=False)
class Memory:
    """When (s), where (D,) px and from which angles (M,) a track was last seen, and how many frames that stands for."""

    t: float = -np.inf
    place: Array | None = None
    point: Array | None = None
    spots: float = 0.0
    postures: float = 0.0


@dataclass(frozen=True, eq=False)
class Sight:
    """One track seen at an instant t (s): model, value (D,), pixel variance (D,), pace, near, memory."""

    model: ForwardModel
    t: float
    value: Array
    var: Array
    pace: Array
    near: float
    memory: Memory

    def at(self, x: Array) -> tuple[Array, Array, Array, Array, Memory]:
        """At angles x (M,): mean (D,), Jacobian (D,M), model variance (D,), the whole as `variances` has it, memory."""
        mean, jac, model = (part[0] for part in self.model.predict(x[None]))
        last, spots, postures = self.memory, 1.0, 1.0
        if last.place is not None and last.point is not None:
            error = model + self.var * (self.near > 0)
            fade = float(_faded(np.array(self.t - last.t), _span(error[None], jac[None], self.pace)[0]))
            postures += fade * float(np.exp(-np.linalg.norm(x - last.point) / ALIKE)) * last.postures
            if self.near:
                spots += fade * float(np.exp(-np.linalg.norm(self.value - last.place) / self.near)) * last.spots
        var = self.var * (2.0 * spots - 1.0) + model * (2.0 * postures - 1.0)
        return mean, jac, model, var, Memory(self.t, self.value, x, spots, postures)
