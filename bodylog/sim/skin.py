"""The skin: 117 proximity cells around the limb next
to the end effector, and their readings of a hand.
"""

import numpy as np

from ..types import Array

RINGS = 13
COLUMNS = 9
RADIUS = 0.03
CELLS = RINGS * COLUMNS
THRESHOLD = 0.7
_PITCH = 0.01
_REACH = 0.01
_REST = 0.08
_MOST = 0.96
_NOISE = 0.015

THRESHOLD_GAP = _REACH * float(np.sqrt(np.log((_MOST - _REST) / (THRESHOLD - _REST))))
"""The distance (m) at which a cell reads the threshold."""


def cell_places() -> Array:
    """Cell centres (117,3) m in the frame of the skin's link;
    cell = column·13 + ring, ring 0 farthest from the tip.
    """
    angle = np.repeat(2 * np.pi * np.arange(COLUMNS) / COLUMNS, RINGS)
    along = np.tile((np.arange(RINGS) + 0.5) * _PITCH, COLUMNS)
    return np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), along])


def rest_readings(rng: np.random.Generator) -> Array:
    """Each cell's reading when nothing is near (117,)."""
    return _REST + rng.uniform(-0.01, 0.01, CELLS)


def proximity_readings(hand: Array, hand_radius: float, base: Array) -> Array:
    """Noiseless readings (N,117) with the hand's
    centre at `hand` (N,3) m, NaN rows when it is away.
    """
    distance = np.linalg.norm(hand[:, None, :] - cell_places(), axis=2) - hand_radius
    closeness = np.exp(-((np.maximum(distance, 0.0) / _REACH) ** 2))
    return np.asarray(base + (_MOST - base) * np.nan_to_num(closeness))


def add_skin_noise(signal: Array, rng: np.random.Generator) -> Array:
    """Readings (N,117) float32 in (0,1): `signal` with sensor noise."""
    return np.clip(signal + rng.normal(0.0, _NOISE, signal.shape), 0.001, 0.999).astype(np.float32)


def threshold_crossings(t: Array, signal: Array) -> tuple[float, float]:
    """First and last time (s) the strongest cell of signal
    (N,117), low at both ends, crosses the threshold.
    """
    over = signal.max(axis=1) - THRESHOLD
    touched = np.flatnonzero(over > 0)
    first = touched[0]
    last = touched[-1]
    onset = np.interp(0.0, over[first - 1 : first + 1], t[first - 1 : first + 1])
    offset = np.interp(0.0, over[last : last + 2][::-1], t[last : last + 2][::-1])
    return float(onset), float(offset)
