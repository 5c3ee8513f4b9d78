"""Pictures that stand still while the encoders move: a camera that repeats its last one lies."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...types import Array, Fault, Health

if TYPE_CHECKING:
    from ..measurements.records import Encoders, Sighting

LASTING = 0.5
"""s: a track that repeats one place exactly for longer may be that of a camera that stands still."""
FRAMES, PARTS, SIGMAS, LEAST = 5, 8, 6.0, 1.0
"""Frames in a row at least, parts of a row in which encoders are averaged, and how far what is seen must have moved
between two of them, whichever encoder is left out: standard deviations of these averages, and px."""


def unfrozen(
    seen: Iterable["Sighting"], encoders: "Encoders | None", used: dict[str, Health]
) -> tuple[list["Sighting"], tuple[Fault, ...]]:
    """Sightings without places repeated exactly while by the encoders what is seen moved; counted, and the faults."""
    told, faults = [], list[Fault]()
    for sighting in seen:
        values, found = _moving(sighting, encoders) if encoders is not None else (sighting.values, [])
        if found:
            health, left = used[sighting.name], int(np.isfinite(values).all(axis=1).sum())
            rejected = {**health.rejected, "frozen": health.used - left}
            used[sighting.name] = replace(health, used=left, rejected=rejected)
        told.append(replace(sighting, values=values))
        faults += found
    return told, tuple(faults)


def _moving(sighting: "Sighting", encoders: "Encoders") -> tuple[Array, list[Fault]]:
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


def _moved(sighting: "Sighting", encoders: "Encoders", begin: float, end: float) -> float:
    """How far (px) by the encoders what is seen moved between two parts of a stretch; 0 where not certainly."""
    inside = (encoders.t >= begin) & (encoders.t <= end)
    averaged = _averaged(encoders.t[inside], encoders.values[inside], np.linspace(begin, end, PARTS + 1))
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
