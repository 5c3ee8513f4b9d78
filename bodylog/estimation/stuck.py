"""Pictures that stand still while the encoders move: a camera that repeats its last one lies."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..types import Array, Fault, Health

if TYPE_CHECKING:
    from .senses import Encoders, Sighting

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
    heard = np.isfinite(encoders.values).all(axis=1) & (encoders.t >= begin) & (encoders.t <= end)
    x = encoders.values[heard]
    if len(x) < 2 * PARTS:
        return 0.0
    means = np.stack([part.mean(axis=0) for part in np.array_split(x, PARTS)])
    scatter = 1.4826 * np.median(np.abs(np.diff(x, axis=0)), axis=0) / np.sqrt(2.0)
    noise = np.square(sighting.model.predict(means)[1] * scatter).sum(axis=(1, 2)).max() * 2.0 * PARTS / len(x)
    # one encoder against the pictures may lie itself
    without = [np.where(alone, means[0], means) for alone in np.eye(means.shape[1]) > 0]
    apart = min(_spread(sighting.model.predict(some)[0]) for some in without)
    return apart if apart > max(SIGMAS * float(np.sqrt(noise)), LEAST) else 0.0


def _spread(places: Array) -> float:
    """The largest distance between two of the places (N,D)."""
    return float(np.linalg.norm(places[:, None] - places[None], axis=2).max())
