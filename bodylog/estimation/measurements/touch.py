"""Touch as a sighting: while skin and image are stroked in synchrony, the stroking hand is at the effector."""

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Features, Health
from .contract import Measured
from .records import Sighting
from .track import ascending

LEAST = 1e-9
"""A touch with less weight is ignored."""
COUNTS = 1e-3
"""A touch with less weight, a thousandth of a synchronous one, is used but not counted as used."""


class Touch:
    """The sense of touch: a synchronous stroke locates the effector at the hand that strokes it."""

    @property
    def group(self) -> str:
        """Touch."""
        return "touch"

    def names(self, features: Features, body: BodyModel) -> tuple[str, ...]:
        """Touch, where the body predicts the effector."""
        return ("touch",) if "effector" in body.senses else ()

    def read(self, name: str, features: Features, body: BodyModel, whole: bool = True) -> Measured:
        """Read the effector's positions by touch."""
        t, values, var, source_ns, count = sightings(features, body, whole)
        seen = 0 if features.touches is None else len(features.touches)
        paired = sum(bool(np.isfinite(pair.delay)) and pair.weight <= COUNTS for pair in features.synchrony)
        reasons = {"not synchronous": min(paired, seen - count), "no stroke seen": max(seen - count - paired, 0)}
        left = {reason: number for reason, number in reasons.items() if number}
        rising = ascending(t)
        t, values, var, source_ns = (part[rising] for part in (t, values, var, source_ns))
        return Measured(Sighting(name, body.senses["effector"], t, values, var, source_ns), Health(seen, count, left))


def sightings(features: Features, body: BodyModel, whole: bool = True) -> tuple[Array, Array, Array, Array, int]:
    """Effector by touch: t (K,) s · values (K,2) px · variance (K,2) px² · source_ns (K,); touches used.

    ln g_t = −b₁ w |g_v − o_v|² + const is a Gaussian of variance 1/(2 b₁ w) about the hand, or about the learned
    position of the touched cell. A hand strokes along the limb, so errors of one touch's frames are correlated: `whole`
    makes all of them count as one sighting.
    """
    nothing = np.empty(0), np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.int64), 0
    hand = features.hand
    if hand is None or not features.touches:
        return nothing
    seen, strongest = np.isfinite(hand.values).all(axis=1), weights(features, hand.t)
    parts, taken, count = [], np.zeros(len(hand.t), bool), 0
    for pair in features.synchrony:
        touch = features.touches[pair.touch]
        during = seen & ~taken & (hand.t >= touch.onset) & (hand.t <= touch.offset) & (strongest == pair.weight)
        taken |= during
        if pair.weight > LEAST and during.any():
            u, v, var = _place(body, touch.strongest)
            var = var / pair.weight * (during.sum() if whole else 1)
            count += pair.weight > COUNTS
            parts.append((hand.t[during], hand.values[during] - (u, v), var, hand.source_ns[during]))
    if not parts:
        return nothing
    parts.sort(key=lambda part: float(part[0][0]))
    t, values, variances, source_ns = zip(*parts, strict=True)
    spread = np.concatenate([np.full_like(places, one) for places, one in zip(values, variances, strict=True)])
    return np.concatenate(t), np.concatenate(values), spread, np.concatenate(source_ns), count


def _place(body: BodyModel, cell: int) -> tuple[float, float, float]:
    """A cell's position relative to the effector (u, v) px, and its variance px²."""
    if cell not in body.cells:
        return 0.0, 0.0, 1.0 / (2.0 * body.touch.b1)
    u, v, spread = body.cells[cell]
    return u, v, spread**2


def weights(features: Features, t: Array) -> Array:
    """Synchrony weight (K,) of the touch at each time t (K,) s, 0 without a touch."""
    weight = np.zeros(len(t))
    for pair in features.synchrony:
        touch = (features.touches or ())[pair.touch]
        during = (t >= touch.onset) & (t <= touch.offset)
        weight[during] = np.maximum(weight[during], pair.weight)
    return weight
