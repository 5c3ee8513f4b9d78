"""Frozen cameras: images repeat while the encoders show motion."""

from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Fault, FaultKind
from ..measurements.long_arrays import find_finite_rows
from ..measurements.records import Encoders, Evidence, Sighting
from .repeats import find_equal_stretches, split_stretch
from .threshold import EVIDENCE_THRESHOLD_NATS


def detect_frozen_camera(evidence: Evidence, body: BodyModel) -> Evidence:
    """Remove track positions that repeat exactly while the encoders predict motion."""
    if evidence.encoders is None or "encoders" in body.senses:
        return evidence
    used = dict(evidence.used)
    sightings = list[Sighting]()
    faults = list[Fault]()
    for sighting in evidence.sightings:
        values, found = (
            _remove_false_repeats(sighting, evidence.encoders)
            if sighting.name != "touch"
            else (sighting.values, [])
        )
        if found:
            health = used[sighting.name]
            left = int(find_finite_rows(values).sum())
            rejected = {**health.rejected, "frozen": health.used - left}
            used[sighting.name] = replace(health, used=left, rejected=rejected)
        sightings.append(replace(sighting, values=values))
        faults += found
    return replace(
        evidence, sightings=tuple(sightings), used=used, faults=(*evidence.faults, *faults)
    )


def _remove_false_repeats(sighting: Sighting, encoders: Encoders) -> tuple[Array, list[Fault]]:
    """Return positions (N,D) with false repeats as NaN,
    the first of each stretch kept, and the faults.
    """
    shown = np.flatnonzero(find_finite_rows(sighting.values))
    values = sighting.values.copy()
    found = []
    for begin, end in find_equal_stretches(sighting.t[shown], sighting.values[shown]):
        own = shown[begin:end]
        if moved := _predict_largest_motion(
            sighting, encoders, sighting.t[own[0]], sighting.t[own[-1]]
        ):
            values[own[1:]] = np.nan
            since = float(sighting.t[own[1]])
            until = float(sighting.t[shown[end]]) if end < len(shown) else None
            unit = getattr(sighting.model, "unit", "px")
            found.append(
                Fault("vision", sighting.name, FaultKind.FROZEN, since, moved, unit, until=until)
            )
    return values, found


def _predict_largest_motion(
    sighting: Sighting, encoders: Encoders, begin: float, end: float
) -> float:
    """Largest motion (px or mm) that the encoders predict from
    the first part of a stretch on; 0 if not significant.
    """
    inside = (encoders.t >= begin) & (encoders.t <= end)
    x = encoders.at(encoders.t[inside])
    parts = split_stretch(encoders.t[inside])
    if not parts or not np.isfinite(x).all():
        return 0.0
    means = np.stack([x[part].mean(axis=0) for part in parts])
    var = encoders.variance / np.maximum(
        np.isfinite(encoders.values[inside]).sum(axis=0) / len(parts), 1.0
    )
    noise = 2.0 * (np.square(sighting.model.predict(means)[1]) * var).sum(axis=(1, 2)).max()
    # a single encoder against the images may itself be faulty
    without = [np.where(alone, means[0], means) for alone in np.eye(means.shape[1]) > 0]
    places = np.stack([sighting.model.predict(some)[0] for some in without])
    apart = float(np.linalg.norm(places - places[:, :1], axis=2).max(axis=1).min())
    # the largest of as many distances as there are parts
    return (
        apart
        if 0.5 * apart**2 > (EVIDENCE_THRESHOLD_NATS + np.log(len(parts))) * noise and apart > 1.0
        else 0.0
    )
