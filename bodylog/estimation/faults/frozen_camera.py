"""Pictures that stand still while the encoders move: a camera that repeats its last one lies."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Fault
from ..measurements.records import Encoders, Evidence, Sighting
from .contract import Verdict

LASTING = 0.5
"""s: a track that repeats one place exactly for longer may be that of a camera that stands still."""
FRAMES, PARTS, SIGMAS, LEAST = 5, 8, 6.0, 1.0
"""Frames in a row at least, parts of a row in which encoders are averaged, and how far what is seen must have moved
between two of them, whichever encoder is left out: standard deviations of these averages, and px."""


def detect(evidence: Evidence, body: BodyModel) -> Verdict:
    """Tracks without places repeated exactly while by the encoders what is seen moved."""
    if evidence.encoders is None or "encoders" in body.senses:
        return Verdict(evidence)
    used, sightings, faults = dict(evidence.used), list[Sighting](), list[Fault]()
    for sighting in evidence.sightings:
        values, found = _moving(sighting, evidence.encoders) if sighting.name != "touch" else (sighting.values, [])
        if found:
            health, left = used[sighting.name], int(np.isfinite(values).all(axis=1).sum())
            rejected = {**health.rejected, "frozen": health.used - left}
            used[sighting.name] = replace(health, used=left, rejected=rejected)
        sightings.append(replace(sighting, values=values))
        faults += found
    return Verdict(replace(evidence, sightings=tuple(sightings), used=used), tuple(faults))


def _moving(sighting: Sighting, encoders: Encoders) -> tuple[Array, list[Fault]]:
    """Places (N,D) with those repeated wrongly, but the first of each run, as not seen."""
    seen = np.flatnonzero(np.isfinite(sighting.values).all(axis=1))
    values, found = sighting.values.copy(), []
    for begin, end in _repeats(sighting.t[seen], sighting.values[seen]):
        rows = seen[begin:end]
        if moved := _moved(sighting, encoders, sighting.t[rows[0]], sighting.t[rows[-1]]):
            values[rows[1:]] = np.nan
            found.append(Fault("vision", sighting.name, "frozen", float(sighting.t[rows[1]]), moved, "px"))
    return values, found


def _repeats(t: Array, places: Array) -> Sequence[tuple[int, int]]:
    """Stretches [begin, end) of places (N,D) that are the same to the last bit, for long."""
    if len(t) < FRAMES:
        return ()
    new = np.flatnonzero(np.append(True, (np.diff(places, axis=0) != 0.0).any(axis=1)))
    runs = zip(new, np.append(new[1:], len(t)), strict=True)
    return [(int(a), int(b)) for a, b in runs if b - a >= FRAMES and t[b - 1] - t[a] > LASTING]


def _moved(sighting: Sighting, encoders: Encoders, begin: float, end: float) -> float:
    """How far (px) by the encoders what is seen moved between two parts of a stretch; 0 where not certainly."""
    inside = (encoders.t >= begin) & (encoders.t <= end)
    values = encoders.values[inside]
    for joint in np.flatnonzero(~np.isfinite(values).any(axis=0)):
        # one that says nothing meanwhile speaks of no motion
        before = encoders.values[: np.searchsorted(encoders.t, begin), joint]
        values[:, joint] = before[np.isfinite(before)][-1:] if np.isfinite(before).any() else np.nan
    averaged = _averaged(encoders.t[inside], values, np.linspace(begin, end, PARTS + 1))
    if averaged is None:
        return 0.0
    means, std = averaged
    noise = 2.0 * np.square(sighting.model.predict(means)[1] * std).sum(axis=(1, 2)).max()
    # one encoder against the pictures may lie itself
    without = [np.where(alone, means[0], means) for alone in np.eye(means.shape[1]) > 0]
    apart = min(_spread(sighting.model.predict(some)[0]) for some in without)
    return apart if apart > max(SIGMAS * float(np.sqrt(noise)), LEAST) else 0.0


def _averaged(t: Array, values: Array, edges: Array) -> tuple[Array, Array] | None:
    """Means (P,M) of each encoder's readings (N,M) between P+1 edges, s, and the std (M,) of one; None where too few.

    Encoders of several topics speak at times of their own: where one is silent its value is NaN.
    """
    part = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)
    means, std = np.empty((len(edges) - 1, values.shape[1])), np.empty(values.shape[1])
    for j, column in enumerate(values.T):
        there = np.isfinite(column)
        counts = np.bincount(part[there], minlength=len(means))
        if counts.min() < 2:
            return None
        means[:, j] = np.bincount(part[there], column[there], len(means)) / counts
        scatter = 1.4826 * np.median(np.abs(np.diff(column[there]))) / np.sqrt(2.0)
        std[j] = scatter / np.sqrt(counts.min())
    return means, std


def _spread(places: Array) -> float:
    """The largest distance between two of the places (N,D)."""
    return float(np.linalg.norm(places[:, None] - places[None], axis=2).max())
