"""The paper's baseline: a Kalman filter on the encoders alone, static model, Q = 0.001, R = 1."""

import numpy as np

from ..types import Array
from .printed import Signals

PROCESS, NOISE = 0.001, 1.0
"""rad² per step and rad², as printed."""


def kalman(signals: Signals, start: Array) -> Array:
    """The belief (N,M) rad; its variance begins at R, as no other is printed."""
    x, var, found = np.array(start, float), NOISE, np.empty_like(signals.encoders)
    for k, read in enumerate(signals.encoders):
        var += PROCESS
        gain = var / (var + NOISE)
        x = x + gain * np.where(np.isfinite(read), read - x, 0.0)
        var *= 1.0 - gain
        found[k] = x
    return found
