"""Noise of each sense from its own readings: encoders, process noise, and pixel noise of tracks."""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..measurements.records import Evidence, Sighting
from .encoder_noise import FEWEST, Learned, learn

MEMORY = 1.0
"""s: longest memory of a filter for a joint at rest."""


@dataclass(frozen=True, eq=False)
class OwnNoise:
    """Learned for motion of order 2 and of order 3 (None if readings are too few), and variance factors {track}."""

    acceleration: Learned
    jerk: Learned | None
    scale: dict[str, float]

    @property
    def preferred(self) -> Learned:
        """The motion with the greater evidence."""
        if self.jerk is None or self.jerk.evidence < self.acceleration.evidence:
            return self.acceleration
        return self.jerk


def own_noise(evidence: Evidence, white: Learned, encoder: Array) -> OwnNoise:
    """Learn from the log; noise under `white` acceleration is known; `encoder` (M,) rad²: for silent joints."""
    found = evidence.encoders
    assert found is not None
    white = replace(white, process=np.maximum(white.process, floor(found.t, white.encoder, 2)))
    counts = np.isfinite(found.values).sum(axis=0)
    if ((counts > 0) & (counts <= FEWEST)).any():
        return OwnNoise(white, None, {})
    tracks = [one for one in evidence.sightings if one.name != "touch" and seen(one).sum() > FEWEST]
    rows = [(one.t[seen(one)], row) for one in tracks for row in one.values[seen(one)].T]
    smooth = learn(found, encoder, np.zeros(len(counts)), 3, rows)
    smooth = replace(smooth, process=np.maximum(smooth.process, floor(found.t, smooth.encoder, 3)))
    scale, noise = {}, list(smooth.beside)
    for one in tracks:
        own = [noise.pop(0) for _ in one.model.outputs]
        # correlated frames predict each other well, which is no evidence of lower pixel noise
        scale[one.name] = max(1.0, float(np.mean(own / np.median(one.var[seen(one)], axis=0))))
    return OwnNoise(white, smooth, scale)


def seen(track: Sighting) -> Array:
    """Images (F,) of a track with a sighting."""
    return np.asarray(np.isfinite(track.values).all(axis=1))


def floor(t: Array, encoder: Array, order: int) -> Array:
    """Least density (M,), which bounds a filter's memory, (R Δt / q)^(1/2p), by MEMORY."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return np.asarray(encoder * step / MEMORY ** (2 * order))
