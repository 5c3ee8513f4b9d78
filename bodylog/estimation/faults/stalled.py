"""Encoders that repeat one reading while images show that their joint moved: what is frozen, and no rest.

Residuals of what is seen, against what encoders foretell, are laid to one joint after the other. The joint that repeats
is frozen where moving explains them, and no other joint's moving does.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from ...types import Array
from ..measurements.records import Encoders, Sighting
from ..measurements.timeline import spans
from ..noise.quantisation import grain, resolved
from .frozen import repeats
from .jumping import LEAST
from .threshold import NATS

PART, SPAN, FEWEST = 0.25, 4.0, 3
"""s of frames that make one place, of a window of the log · and frames in a part at least."""
STEPS = 4
"""Gauss–Newton steps to the angle that a place asks for."""
LEFT = 0.2
"""Share of what is explained that may be left."""


def stalled(encoders: Encoders, sightings: Sequence[Sighting]) -> Iterator[tuple[int, int, int]]:
    """Joint and stretch [begin, end) of its readings that images contradict; the first of them was sound."""
    seen = [s for s in sightings if s.name != "touch"]
    if not seen or encoders.values.shape[1] == 0 or not np.isfinite(encoders.values).any(axis=0).all():
        return
    for joint, column in enumerate(encoders.values.T):
        for begin, end in repeats(encoders.t, column):
            windows = spans(encoders.t[begin : end - 1], SPAN)
            if any(_moved(encoders, joint, s, w, min(w + SPAN, encoders.t[end - 1])) for w in windows for s in seen):
                yield joint, begin + 1, end


def _moved(encoders: Encoders, joint: int, sighting: Sighting, begin: float, end: float) -> bool:
    """Whether what is seen from begin to end (s) asks for a motion of this joint alone, beyond the encoder's step."""
    rows = np.isfinite(sighting.values).all(axis=1) & (sighting.t > begin) & (sighting.t <= end)
    parts = [p for p in _parts(sighting.t[rows], begin) if len(p) >= FEWEST]
    if len(parts) < 2:
        return False
    x = np.stack([_read(encoders, column, sighting.t[rows]) for column in encoders.values.T], axis=1)
    y, var = sighting.values[rows], sighting.var[rows]
    middle = np.stack([np.median(x[p], axis=0) for p in parts])
    # how frames differ from the part's middle by what encoders say, taken off before they are averaged
    known, jac, _ = sighting.model.predict(x)
    at, _, model = sighting.model.predict(middle)
    place = np.stack([np.median(y[p] - known[p], axis=0) for p in parts]) + at
    noise = np.stack([1.6 * var[p].mean(axis=0) / len(p) for p in parts]) + model
    noise += np.einsum("pdm,m->pd", np.stack([jac[p].mean(axis=0) for p in parts]) ** 2, _steps(encoders))
    found = [_explained(sighting, place, noise, middle, k) for k in range(x.shape[1])]
    (gain, left, apart), others = found[joint], [g for k, (g, *_) in enumerate(found) if k != joint]
    least = max(LEAST, 2.0 * grain(encoders.values[np.isfinite(encoders.values[:, joint]), joint]))
    beside = max(others, default=0.0)
    # beyond rest, and beyond any other joint's moving
    return gain - len(parts) > NATS and gain - beside > NATS and left < LEFT * gain + len(parts) and apart > least


def _explained(
    sighting: Sighting, place: Array, noise: Array, x: Array, joint: int
) -> tuple[float, float, float]:  # fmt: skip
    """Nats that moving one joint explains of places (P,D) seen at postures x (P,M), nats left, and how far it moves."""
    moved, none = np.zeros(len(x)), sighting.model.predict(x)[0]
    for _ in range(STEPS):
        mean, jac, _ = sighting.model.predict(x + np.outer(moved, np.arange(x.shape[1]) == joint))
        lean, off = jac[:, :, joint], place - mean
        stiff = (lean * lean / noise).sum(axis=1)
        moved += np.divide((lean * off / noise).sum(axis=1), stiff, out=np.zeros_like(stiff), where=stiff > 0.0)
        moved = np.clip(moved, -1.0, 1.0)
    mean = sighting.model.predict(x + np.outer(moved, np.arange(x.shape[1]) == joint))[0]
    # an offset that lasts is no motion
    still, left = _misfit(place - none, noise, True), _misfit(place - mean, noise, False)
    return still - left, left, float(np.ptp(moved))


def _misfit(off: Array, noise: Array, centred: bool) -> float:
    """Half the squares of residuals off (P,D) over their variances, without their weighted mean if `centred`."""
    mean = (off / noise).sum(axis=0) / (1.0 / noise).sum(axis=0) if centred else 0.0
    return float(0.5 * (np.square(off - mean) / noise).sum())


def _parts(t: Array, begin: float) -> list[Array]:
    """Rows of frames at t (F,) s by parts of the time since begin."""
    number = np.floor((t - begin) / PART).astype(int)
    return [np.flatnonzero(number == k) for k in np.unique(number)]


def _read(encoders: Encoders, column: Array, t: Array) -> Array:
    """What an encoder reads at t (F,) s, between its readings."""
    known = np.isfinite(column)
    return np.interp(t, encoders.t[known], column[known])


def _steps(encoders: Encoders) -> Array:
    """Variance (M,) rad² of counting in steps, or of what readings scatter by where they do not."""
    found = []
    for column in encoders.values.T:
        y = column[np.isfinite(column)]
        scatter = 1.4826 * float(np.median(np.abs(np.diff(y, 2)))) if len(y) > 2 else 0.0
        found.append(max(resolved(y), scatter**2 / 6.0))
    return np.array(found)
