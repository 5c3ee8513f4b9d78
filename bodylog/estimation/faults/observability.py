"""Warnings for joints and stretches without encoder
readings, where images alone may not determine the angles.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...types import Array, Finding
from ...wording import list_in_words
from ..measurements.gather import list_unread_joints
from ..measurements.long_arrays import index_true_rows
from ..measurements.records import Evidence
from ..noise.encoder_noise import MAX_MEMORY_S


def warn_of_undetermined_joints(evidence: Evidence, poses: bool) -> Evidence:
    """Warn where images must determine joints that have no
    encoder readings, ever or (unless still poses) for long.
    """
    return replace(
        evidence, findings=(*evidence.findings, *_undetermined_findings(evidence, poses))
    )


def _undetermined_findings(evidence: Evidence, poses: bool) -> Iterator[Finding]:
    """Yield warnings where images give fewer numbers
    than there are joints without encoder readings.
    """
    names = evidence.joints
    encoders = evidence.encoders
    sightings = [sighting for sighting in evidence.sightings if sighting.name != "touch"]
    mute = list_unread_joints(names, encoders)
    seen = sum(sighting.values.shape[1] for sighting in sightings)
    if 0 < seen < len(mute):
        yield Finding(
            "warning",
            f"vision: {seen} numbers per image for {len(mute)} joints without an encoder "
            f"({', '.join(mute)}): "
            "the posture is ambiguous, errors may far exceed the error bars; add encoders or "
            "a camera",
        )
    if encoders is None or mute or not seen or poses:
        return
    frames = np.sort(np.concatenate([sighting.t for sighting in sightings]))
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, column in zip(names, encoders.values.T, strict=True):
        groups.setdefault(
            tuple(_find_long_silence(frames, encoders.t[index_true_rows(np.isfinite(column))])), []
        ).append(name)
    for when, joints in groups.items():
        if when and (len(joints) > seen or len(joints) == len(names)):
            loose = (
                f": {seen} numbers per image do not determine {len(joints)} joints, error bars "
                "may be too small"
            )
            text = (
                f"encoders: {', '.join(joints)} silent from "
                f"{list_in_words(when, ' times', ', from ')}"
            )
            yield Finding("warning", f"{text}, while images continue{loose * (len(joints) > seen)}")


def _find_long_silence(frames: Array, known: Array) -> Iterator[str]:
    """Yield the silences beyond all MAX_MEMORY_S of an encoder
    with readings at known (N,) s while there are frames (F,).
    """
    for k in np.flatnonzero(np.diff(known) > MAX_MEMORY_S):
        if np.searchsorted(frames, known[k]) < np.searchsorted(frames, known[k + 1]):
            yield f"{known[k]:.3f} to {known[k + 1]:.3f} s"
    if frames[-1] - known[-1] > MAX_MEMORY_S:
        yield f"{known[-1]:.3f} s on"
    if known[0] - frames[0] > MAX_MEMORY_S:
        yield f"the first image to {known[0]:.3f} s"
