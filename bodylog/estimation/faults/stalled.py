"""Encoders that repeat one reading while images show that their joint moved.

Residuals of the images against the encoders' predictions are explained
by motion of one joint at a time. A repeating encoder is frozen if
motion of its joint explains them and motion of no other joint does.
"""

from collections.abc import Sequence

import numpy as np

from ...types import Array
from ..inference.initial_path import OFFSET_STD
from ..measurements.long_arrays import find_finite_rows
from ..measurements.records import Encoders, Sighting
from ..noise.quantisation import step_size
from .repeats import split_stretch


def motion_nats(
    encoders: Encoders, images: Sequence[Sighting], joint: int, begin: int, end: int
) -> float:
    """Nats that motion of a joint wins in images while
    its encoder repeats the readings [begin, end).
    """
    return max(
        (
            _joint_motion_nats(encoders, joint, s, encoders.t[begin], encoders.t[end - 1])
            for s in images
        ),
        default=0.0,
    )


def _joint_motion_nats(
    encoders: Encoders, joint: int, sighting: Sighting, begin: float, end: float
) -> float:
    """Nats that motion of this joint alone wins in images from begin to end (s); 0 if it leaves
    much unexplained, or is less than the encoder's step.
    """
    rows = find_finite_rows(sighting.values) & (sighting.t > begin) & (sighting.t <= end)
    parts = split_stretch(sighting.t[rows])
    if len(parts) < 2:
        return 0.0
    x = encoders.at(sighting.t[rows])
    y = sighting.values[rows]
    var = sighting.var[rows]
    middle = np.stack([np.median(x[p], axis=0) for p in parts])
    # motion within a part, as the encoders predict it, is subtracted before averaging
    known, (at, jac, model) = sighting.model.predict(x)[0], sighting.model.predict(middle)
    place = np.stack([np.median(y[p] - known[p], axis=0) for p in parts]) + at
    noise = np.stack([1.6 * var[p].mean(axis=0) / len(p) for p in parts]) + model
    noise += np.square(jac) @ encoders.variance
    found = [_explain_by_joint_motion(sighting, place, noise, middle, k) for k in range(x.shape[1])]
    (gain, left, apart), others = found[joint], [g for k, (g, *_) in enumerate(found) if k != joint]
    least = max(
        OFFSET_STD, 2.0 * step_size(encoders.values[np.isfinite(encoders.values[:, joint]), joint])
    )
    # better than rest, and better than motion of any other joint
    won = min(gain - len(parts), gain - max(others, default=0.0))
    return won if left < 0.2 * gain + len(parts) and apart > least else 0.0


def _explain_by_joint_motion(
    sighting: Sighting, place: Array, noise: Array, x: Array, joint: int
) -> tuple[float, float, float]:
    """Nats that motion of one joint explains of positions
    (P,D) at postures x (P,M), nats left, and its range (rad).
    """
    own = np.arange(x.shape[1]) == joint
    moved = np.zeros(len(x))
    none = sighting.model.predict(x)[0]
    for _ in range(4):
        mean, jac, _ = sighting.model.predict(x + np.outer(moved, own))
        slope = jac[:, :, joint]
        off = place - mean
        stiff = (slope * slope / noise).sum(axis=1)
        moved += np.divide(
            (slope * off / noise).sum(axis=1), stiff, out=np.zeros_like(stiff), where=stiff > 0.0
        )
        moved = np.clip(moved, -1.0, 1.0)
    left = _sum_squared_misfit(place - sighting.model.predict(x + np.outer(moved, own))[0], noise)
    # a constant offset is not motion
    constant = ((place - none) / noise).sum(axis=0) / (1.0 / noise).sum(axis=0)
    return _sum_squared_misfit(place - none - constant, noise) - left, left, float(np.ptp(moved))


def _sum_squared_misfit(off: Array, noise: Array) -> float:
    """Half the squared residuals off (P,D) over their variances."""
    return float(0.5 * (np.square(off) / noise).sum())
