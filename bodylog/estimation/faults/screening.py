"""One pass of all fault detectors over the measurements.

It also warns of readings beyond the range that the body was learned in, or in another unit, and of
joints and stretches without encoder readings, where images alone may not determine the angles.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import tau

import numpy as np

from ...body_model import BodyModel
from ...errors import ModelError
from ...settings import EstimationSettings
from ...types import Array, Features, Finding
from ...wording import list_in_words
from ..measurements.gather import gather_measurements, list_unread_joints, require_measurements
from ..measurements.long_arrays import index_true_rows
from ..measurements.records import Evidence
from ..noise.encoder_noise import MAX_MEMORY_S
from .encoder_faults import detect_encoder_faults
from .moved_camera import detect_moved_camera
from .repeats import detect_frozen_camera


def _warn_of_undetermined_joints(evidence: Evidence, poses: bool) -> Iterator[Finding]:
    """Yield warnings where images must determine joints that have no encoder readings, ever or
    (unless still poses) for long, and give no more numbers than there are such joints.
    """
    names = evidence.joints
    encoders = evidence.encoders
    sightings = [sighting for sighting in evidence.sightings if sighting.name != "touch"]
    mute = list_unread_joints(evidence)
    seen = sum(sighting.values.shape[1] for sighting in sightings)
    if 0 < seen <= len(mute):
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
        if not when or len(joints) < min(seen, len(names)):
            continue
        text = (
            f"encoders: {', '.join(joints)} silent from "
            f"{list_in_words(when, ' times', ', from ')}, while images continue"
        )
        if len(joints) >= seen:
            fit = "may fit a mirrored posture of" if len(joints) == seen else "do not determine"
            text += (
                f": {seen} numbers per image {fit} {len(joints)} joints, "
                "error bars may be too small"
            )
        yield Finding("warning", text)


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


def _warn_of_unexplored_range(readings: Array, body: BodyModel) -> Iterator[Finding]:
    """Yield a warning for each joint whose readings (N,M) rad are mostly out of the range that the
    body was learned in; ModelError for degrees.
    """
    known = [
        getattr(model, "samples", np.empty((0, len(body.joints)))) for model in body.senses.values()
    ]
    if "encoders" in body.senses or not len(
        explored := np.concatenate([np.empty((0, len(body.joints))), *known])
    ):
        return
    ranges = list(
        zip(body.joints, readings.T, explored.min(axis=0), explored.max(axis=0), strict=True)
    )
    beyond = [one for one in ranges if not _lies_in_explored_range(*one[1:])]
    wide = any(
        np.ptp(np.nanpercentile(y, [5, 95])) > max(tau, high - low) for _, y, low, high in beyond
    )
    if wide and all(
        _lies_in_explored_range(np.deg2rad(y), low, high) for _, y, low, high in ranges
    ):
        text = "; ".join(_describe_ranges(*one) for one in beyond)
        raise ModelError(
            f'joints: {text}: these are degrees; type [body] unit = "deg" in robot.toml'
        )
    for name, y, low, high in beyond:
        turns = round(float(np.nanmedian(y) - (low + high) / 2.0) / tau)
        off = turns and _lies_in_explored_range(y - turns * tau, low, high)
        why = f"{turns:+d} whole turns off, home it again" if off else "beyond that"
        text = (
            f"joints: {_describe_ranges(name, y, low, high)}: {why}, or fit a body from a log that "
            "explores it"
        )
        yield Finding("warning", f"{text}; images are of little use there")


def _lies_in_explored_range(readings: Array, low: float, high: float) -> bool:
    """Whether at least half of the finite values (N,) lie
    near the explored range; True if there are no values.

    Near is up to half of the range, and at least half a radian, beyond it.
    """
    readings = readings[np.isfinite(readings)]
    beside = 0.5 * max(1.0, high - low)
    return not len(readings) or bool(
        np.mean((readings >= low - beside) & (readings <= high + beside)) >= 0.5
    )


def _describe_ranges(name: str, readings: Array, low: float, high: float) -> str:
    least, most = np.nanpercentile(readings, [5, 95])
    return (
        f"{name} reads {least:.4g} to {most:.4g} rad, the body was learned from {low:.4g} to "
        f"{high:.4g}"
    )


def screen_measurements(
    features: Features, body: BodyModel, settings: EstimationSettings, repairs: bool = True
) -> Evidence:
    """Gather the measurements that the settings ask for and
    run all detectors; EvidenceError if a named sense is empty.

    Each detector takes the readings of one kind of fault out of the evidence, adds the faults,
    remarks and hypotheses compared, and sees what the ones before it left. Without `repairs`,
    encoder faults are named, but the readings stay as they were.
    """
    gathered = gather_measurements(features, body, settings)
    # readings of unused encoders, too: they give the initial belief
    found = replace(gathered, findings=tuple(_warn_of_unexplored_range(gathered.read, body)))
    # still poses have no motion, and no time from which a sensor is wrong
    if not features.poses:
        named = detect_encoder_faults(found, body)
        found = named if repairs else replace(named, findings=found.findings)  # on repairs
    found = detect_frozen_camera(found, body)
    if not features.poses:
        found = detect_moved_camera(found, body)
    found = require_measurements(
        found if repairs else replace(found, encoders=gathered.encoders), features, body, settings
    )
    warnings = _warn_of_undetermined_joints(found, features.poses)
    return replace(found, findings=(*found.findings, *warnings))
