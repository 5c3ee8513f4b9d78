"""How touch and sight of touch agree: the constants of g_t (paper, "Adding tactile feedback")."""

from collections.abc import Sequence

import numpy as np

from ..types import Array, Features, Finding, TouchConstants
from .gp import GP

_LATE_S = 0.05
_APART_PX = 12.0
_NEAR_S = 0.5
_ASSUMED = 5


def learned(
    features: Sequence[Features], joints: tuple[str, ...], effector: GP | None
) -> tuple[TouchConstants, tuple[Finding, ...]]:
    """Constants from touches paired with strokes, and the remark on where they come from.

    Both forms share them: a = 1, so that g_t is 1 at its peak, and b = 1/(2 variance) of delay or distance. The
    variance starts from 0.05 s (gone beyond 0.1 s, as the illusion is) and 12 px, which count as five pairs.
    """
    delays = np.array([s.delay for f in features for s in f.synchrony if s.stroke is not None])
    delays = delays[np.abs(delays) < _NEAR_S]
    apart = [_apart(f, joints, effector) for f in features if effector is not None and f.touches]
    distances = np.concatenate([np.zeros((0, 2)), *apart])
    late, px = _spread(delays, _LATE_S), _spread(distances, _APART_PX)
    constants = TouchConstants(1.0, 1.0 / (2.0 * px**2), 1.0, 1.0 / (2.0 * late**2))
    return constants, _remarks(len(delays), len(distances), late, px)


def _apart(features: Features, joints: tuple[str, ...], effector: GP | None) -> Array:
    """Hand minus predicted effector (K,2) px at the touches' onsets, where both are known."""
    hand, heard = features.hand, features.joints
    if hand is None or heard is None or effector is None or not set(joints) <= set(heard.names):
        return np.zeros((0, 2))
    onset = np.array([touch.onset for touch in features.touches or ()])
    columns = [heard.values[:, heard.names.index(name)] for name in joints]
    angles = np.column_stack([np.interp(onset, heard.t, column) for column in columns])
    place = np.column_stack([np.interp(onset, hand.t, hand.values[:, d]) for d in range(2)])
    distance = place - effector.predict(angles)[0]
    return np.asarray(distance[np.isfinite(distance).all(axis=1)])


def _spread(values: Array, assumed: float) -> float:
    """Spread about zero per coordinate, by the median so that a stray pair does not count, and what is assumed."""
    found = 1.4826 * np.median(np.abs(values)) if len(values) else 0.0
    return float(np.sqrt((_ASSUMED * assumed**2 + len(values) * found**2) / (_ASSUMED + len(values))))


def _remarks(delays: int, distances: int, late: float, px: float) -> tuple[Finding, ...]:
    if max(delays, distances) == 0:
        return ()
    text = f"touch: {delays} delays, spread {late:.3f} s; {distances} distances, spread {px:.1f} px"
    return (Finding("info", text),)
