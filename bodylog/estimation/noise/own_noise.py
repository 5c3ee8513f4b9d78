"""Noise of encoders and of the motion from the encoders' own readings, for both orders of motion."""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..measurements.records import Encoders
from .encoder_noise import FEWEST, Learned, floor, learn


@dataclass(frozen=True, eq=False)
class OwnNoise:
    """Learned for motion of order 2 and of order 3; None if readings are too few."""

    acceleration: Learned
    jerk: Learned | None

    @property
    def preferred(self) -> Learned:
        """The motion with the greater evidence."""
        if self.jerk is None or self.jerk.evidence < self.acceleration.evidence:
            return self.acceleration
        return self.jerk


def own_noise(encoders: Encoders, white: Learned, encoder: Array) -> OwnNoise:
    """Learn from the log; noise under `white` acceleration is known; `encoder` (M,) rad²: for silent joints."""
    white = replace(white, process=np.maximum(white.process, floor(encoders.t, white.encoder, 2)))
    counts = np.isfinite(encoders.values).sum(axis=0)
    if ((counts > 0) & (counts <= FEWEST)).any():
        return OwnNoise(white, None)
    smooth = learn(encoders, encoder, np.zeros(len(counts)), 3)
    return OwnNoise(white, replace(smooth, process=np.maximum(smooth.process, floor(encoders.t, smooth.encoder, 3))))
