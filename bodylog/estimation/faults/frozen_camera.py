"""Frozen cameras: images repeat while the encoders show motion."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Fault
from ..measurements.long_arrays import any_of_row, median, seen
from ..measurements.records import Encoders, Evidence, Sighting
from .contract import Verdict

LASTING = 0.5
"""s: shortest stretch of exactly repeated positions that may be a frozen camera."""
FRAMES, PARTS, SIGMAS, LEAST = 5, 8, 6.0, 1.0
"""Fewest frames of a stretch, parts in which encoders are averaged, and the least predicted motion between two parts
with any one encoder held still: standard deviations of these averages, and px."""


def detect(evidence: Evidence, body: BodyModel) -> Verdict:
    """Remove track positions that repeat exactly while the encoders predict motion."""
    if evidence.encoders is None or "encoders" in body.senses:
        return Verdict(evidence)
    used, sightings, faults = dict(evidence.used), list[Sighting](), list[Fault]()
    for sighting in evidence.sightings:
        values, found = _moving(sighting, evidence.encoders) if sighting.name != "touch" else (sighting.values, [])
        if found:
            health, left = used[sighting.name], int(seen(values).sum())
            rejected = {**health.rejected, "frozen": health.used - left}
            used[sighting.name] = replace(health, used=left, rejected=rejected)
        sightings.append(replace(sighting, values=values))
        faults += found
    return Verdict(replace(evidence, sightings=tuple(sightings), used=used), tuple(faults))


def _moving(sighting: Sighting, encoders: Encoders) -> tuple[Array, list[Fault]]:
    """Return positions (N,D) with false repeats as NaN, the first of each stretch kept, and the faults."""
    shown = np.flatnonzero(seen(sighting.values))
    values, found = sighting.values.copy(), []
    for begin, end in _repeats(sighting.t[shown], sighting.values[shown]):
        own = shown[begin:end]
        if moved := _moved(sighting, encoders, sighting.t[own[0]], sighting.t[own[-1]]):
            values[own[1:]] = np.nan
            found.append(Fault("vision", sighting.name, "frozen", float(sighting.t[own[1]]), moved, "px"))
    return values, found


def _repeats(t: Array, places: Array) -> Sequence[tuple[int, int]]:
    """Return long stretches [begin, end) of bitwise equal positions (N,D)."""
    if len(t) < FRAMES:
        return ()
    new = np.flatnonzero(np.append(True, any_of_row(np.diff(places, axis=0) != 0.0)))
    end = np.append(new[1:], len(t))
    long = (end - new >= FRAMES) & (t[end - 1] - t[new] > LASTING)
    return list(zip(new[long].tolist(), end[long].tolist(), strict=True))


def _moved(sighting: Sighting, encoders: Encoders, begin: float, end: float) -> float:
    """Largest motion (px) that the encoders predict between two parts of a stretch; 0 if not significant."""
    inside = (encoders.t >= begin) & (encoders.t <= end)
    values = encoders.values[inside]
    for joint in np.flatnonzero(~np.isfinite(values).any(axis=0)):
        # an encoder without readings in the stretch shows no motion: hold its last value
        before = encoders.values[: np.searchsorted(encoders.t, begin), joint]
        values[:, joint] = before[np.isfinite(before)][-1:] if np.isfinite(before).any() else np.nan
    averaged = _averaged(encoders.t[inside], values, np.linspace(begin, end, PARTS + 1))
    if averaged is None:
        return 0.0
    means, std = averaged
    noise = 2.0 * np.square(sighting.model.predict(means)[1] * std).sum(axis=(1, 2)).max()
    # a single encoder against the images may itself be faulty
    without = [np.where(alone, means[0], means) for alone in np.eye(means.shape[1]) > 0]
    apart = min(_spread(sighting.model.predict(some)[0]) for some in without)
    return apart if apart > max(SIGMAS * float(np.sqrt(noise)), LEAST) else 0.0


def _averaged(t: Array, values: Array, edges: Array) -> tuple[Array, Array] | None:
    """Means (P,M) of readings (N,M) between P+1 edges (s), and std (M,) of one mean; None if readings are too few.

    Encoders of several topics have stamps of their own; elsewhere their value is NaN.
    """
    part = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)
    means, std = np.empty((len(edges) - 1, values.shape[1])), np.empty(values.shape[1])
    for j, column in enumerate(values.T):
        there = np.isfinite(column)
        counts = np.bincount(part[there], minlength=len(means))
        if counts.min() < 2:
            return None
        means[:, j] = np.bincount(part[there], column[there], len(means)) / counts
        scatter = 1.4826 * median(np.abs(np.diff(column[there]))) / np.sqrt(2.0)
        std[j] = scatter / np.sqrt(counts.min())
    return means, std


def _spread(places: Array) -> float:
    """Largest distance between two positions (N,D)."""
    return float(np.linalg.norm(places[:, None] - places[None], axis=2).max())
