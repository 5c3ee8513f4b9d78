"""Touch as a sighting: while skin and image are stroked
in synchrony, the stroking hand is at the effector.
"""

from collections.abc import Mapping

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Features, Series, Synchrony
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS
from .long_arrays import find_finite_rows
from .records import Measured, Sighting, build_health
from .track import find_ascending_times

REASONS_WITHOUT_WEIGHT = {
    "not synchronous": "not synchronous with the images",
    "no common cause": "seen elsewhere than it is felt",
}
"""Why a touch has hardly any weight although it is
paired with a stroke, and the same for a warning.
"""


def read_touch(features: Features, body: BodyModel) -> Mapping[str, Measured]:
    """Read the effector's positions by touch, where the body predicts the effector."""
    if "effector" not in body.senses:
        return {}
    found, count = read_touch_sighting(features, body)
    seen = len(features.touches or ())
    paired = sum(
        bool(np.isfinite(pair.delay)) and not is_synchronous(pair) for pair in features.synchrony
    )
    apart = sum(is_synchronous(pair) and not has_common_cause(pair) for pair in features.synchrony)
    reasons = {
        "not synchronous": min(paired, seen - count),
        "no common cause": min(apart, seen - count),
        "no stroke seen": max(seen - count - paired - apart, 0),
    }
    return {"touch": Measured(found, build_health(seen, count, reasons))}


def read_touch_sighting(features: Features, body: BodyModel) -> tuple[Sighting, int]:
    """Effector by touch, positions and variances (K,2) px, px²; and how many touches are used.

    ln g_t = −b₁ w |g_v − o_v|² + const is a Gaussian of variance 1/(2 b₁ w) about the hand, or
    about the learned position of the touched cell. A hand strokes along the limb, so errors of one
    touch's frames are correlated: all of them count as one sighting.
    """
    hand = features.hand
    touches = features.touches or ()
    count = 0
    if hand is None:
        hand = Series(np.empty(0), np.empty((0, 2)), ("u", "v"), "px", np.empty(0, np.int64))
    sound = find_ascending_times(hand.t) & find_finite_rows(hand.values)
    _, pairs = find_strongest_touches(features, hand.t)
    places = np.full(hand.values.shape, np.nan)
    variance = np.ones(hand.values.shape)
    for number, pair in enumerate(features.synchrony):
        during = sound & (pairs == number)
        if has_weight(pair) and during.any():
            u, v, spread = find_cell_place(body, touches[pair.touch].strongest)
            places[during] = hand.values[during] - (u, v)
            variance[during] = spread / pair.event_weight * during.sum()
            count += is_synchronous(pair) and has_common_cause(pair)
    kept = find_finite_rows(places)
    found = (hand.t[kept], places[kept], variance[kept], hand.source_ns[kept])
    return Sighting("touch", body.senses["effector"], *found), count


def is_synchronous(pair: Synchrony) -> bool:
    """Whether a touch counts as used. Its weight is its delay's likelihood over that of none."""
    return bool(pair.weight > np.exp(-EVIDENCE_THRESHOLD_NATS))


def has_weight(pair: Synchrony) -> bool:
    """Whether a touch has a weight; so small a one
    that its variance swamps all others counts as none.
    """
    return pair.event_weight > 1e-9


def has_common_cause(pair: Synchrony) -> bool:
    """Whether touch and stroke are more likely one event at one place than two."""
    return pair.common_cause >= 0.5


def find_cell_place(body: BodyModel, cell: int) -> tuple[float, float, float]:
    """A cell's position relative to the effector (u, v) px, and its variance px²."""
    if cell not in body.cells:
        return 0.0, 0.0, 1.0 / (2.0 * body.touch.b1)
    u, v, spread = body.cells[cell]
    return u, v, spread**2


def find_strongest_touches(features: Features, t: Array) -> tuple[Array, Array]:
    """The greatest synchrony weight of touches at each time
    t (K,) s, 0 without one, and the pair's number, or −1.
    """
    weight = np.zeros(len(t))
    number = np.full(len(t), -1)
    touches = features.touches or ()
    for k, pair in enumerate(features.synchrony if touches else ()):
        touch = touches[pair.touch]
        more = (t >= touch.onset) & (t <= touch.offset) & (pair.event_weight > weight)
        weight[more] = pair.event_weight
        number[more] = k
    return weight, number
