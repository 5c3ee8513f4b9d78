"""Warnings for joints and stretches without encoder readings, where images alone may not determine the angles."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...types import Array, Finding
from ...wording import listed
from ..measurements.gather import silent
from ..measurements.long_arrays import rows
from ..measurements.records import Evidence
from ..noise.encoder_noise import MEMORY


def warned(evidence: Evidence, poses: bool) -> Evidence:
    """Warn where images must determine joints that have no encoder readings, ever or (unless still poses) for long."""
    return replace(evidence, findings=(*evidence.findings, *_findings(evidence, poses)))


def _findings(evidence: Evidence, poses: bool) -> Iterator[Finding]:
    """Yield warnings where images give fewer numbers than there are joints without encoder readings."""
    names, encoders = evidence.joints, evidence.encoders
    sightings = [sighting for sighting in evidence.sightings if sighting.name != "touch"]
    mute = silent(names, encoders)
    seen = sum(sighting.values.shape[1] for sighting in sightings)
    if 0 < seen < len(mute):
        yield Finding(
            "warning",
            f"vision: {seen} numbers per image for {len(mute)} joints without an encoder ({', '.join(mute)}): "
            "the posture is ambiguous, errors may far exceed the error bars; add encoders or a camera",
        )
    if encoders is None or mute or not seen or poses:
        return
    frames = np.sort(np.concatenate([sighting.t for sighting in sightings]))
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, column in zip(names, encoders.values.T, strict=True):
        groups.setdefault(tuple(_silent_from(frames, encoders.t[rows(np.isfinite(column))])), []).append(name)
    for when, joints in groups.items():
        if when and (len(joints) > seen or len(joints) == len(names)):
            loose = f": {seen} numbers per image do not determine {len(joints)} joints, error bars may be too small"
            text = f"encoders: {', '.join(joints)} silent from {listed(when, ' times', ', from ')}"
            yield Finding("warning", f"{text}, while images continue{loose * (len(joints) > seen)}")


def _silent_from(frames: Array, known: Array) -> Iterator[str]:
    """Yield the silences beyond all MEMORY of an encoder with readings at known (N,) s while there are frames (F,)."""
    for k in np.flatnonzero(np.diff(known) > MEMORY):
        if np.searchsorted(frames, known[k]) < np.searchsorted(frames, known[k + 1]):
            yield f"{known[k]:.3f} to {known[k + 1]:.3f} s"
    if frames[-1] - known[-1] > MEMORY:
        yield f"{known[-1]:.3f} s on"
    if known[0] - frames[0] > MEMORY:
        yield f"the first image to {known[0]:.3f} s"
