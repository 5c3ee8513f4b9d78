"""Noise of each sense by its own readings: encoders and how joints move, and how images of a track jitter."""

from dataclasses import dataclass, replace

import numpy as np

from ...types import Array
from ..measurements.records import Evidence, Sighting
from .encoder_noise import FEWEST, Learned, learn

MEMORY = 1.0
"""s of readings that a belief about a resting joint may average."""


@dataclass(frozen=True, eq=False)
class OwnNoise:
    """What was learned for motion of order 2 and of order 3 (None where readings are too few), and factors {track}."""

    acceleration: Learned
    jerk: Learned | None
    scale: dict[str, float]

    @property
    def preferred(self) -> Learned:
        """The motion that the encoders' own evidence prefers."""
        if self.jerk is None or self.jerk.evidence < self.acceleration.evidence:
            return self.acceleration
        return self.jerk


def own_noise(evidence: Evidence, white: Learned, encoder: Array) -> OwnNoise:
    """By the log's encoders, whose noise under `white` acceleration is known; `encoder` (M,) rad² where one is mute."""
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
        # frames that err alike foretell each other well: that is no reason to think perception better than it says
        scale[one.name] = max(1.0, float(np.mean(own / np.median(one.var[seen(one)], axis=0))))
    return OwnNoise(white, smooth, scale)


def seen(track: Sighting) -> Array:
    """Which of a track's images (F,) show something."""
    return np.asarray(np.isfinite(track.values).all(axis=1))


def floor(t: Array, encoder: Array, order: int) -> Array:
    """Least density (M,): a filter's memory, (R Δt / q)^(1/2p), is no longer than MEMORY."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return np.asarray(encoder * step / MEMORY ** (2 * order))
