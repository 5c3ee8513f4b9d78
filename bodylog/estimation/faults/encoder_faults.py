"""Encoder faults that show in the readings alone: frozen,
dead and jumping encoders and glitches, joint by joint.

Offsets, which need the other senses, are found by `encoder_offset`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Fault, FaultKind, Finding, Hypothesis
from ..inference.reacquisition import LONG_SILENCE_S
from ..measurements.reading_units import convert_fault_to_units
from ..measurements.records import Encoders, Evidence, Sighting
from .jumping import (
    SURE_SLIPS,
    find_evident_slips,
    find_jumps,
    find_level_shifts,
    index_resumed_readings,
    measure_slip_nats,
    unwrap_turns,
)
from .repeats import (
    RepeatedReadings,
    find_final_silence,
    find_frozen_readings,
    measure_motion_nats,
    select_images_beside_readings,
)
from .threshold import EVIDENCE_THRESHOLD_NATS
from .true_stretch import refer_to_true_stretch


class ScreenedEncoder(NamedTuple):
    """One encoder: readings (N,) rad without faulty stretches
    and jumps, its faults, and the nats won by each kind.
    """

    values: Array
    faults: Sequence[Fault]
    nats: Mapping[str, float]


def detect_encoder_faults(evidence: Evidence, body: BodyModel) -> Evidence:
    """Remove frozen and dead stretches and glitches, undo
    jumps, and unwrap whole turns where encoders read angles.
    """
    if evidence.encoders is None:
        return evidence
    reads_angles = "encoders" not in body.senses
    read = evidence.encoders
    size = evidence.rad_per_unit
    angled = replace(read, values=size * read.values)
    encoders = _unwrap_columns(angled) if reads_angles else angled
    turned = np.abs(encoders.values - angled.values) > 1.0
    findings = [
        Finding(
            "info",
            f"encoders: {name} wraps by a whole turn at {encoders.t[own][0]:.3f} s; its "
            "angle is unwrapped",
        )
        for name, own in zip(body.joints, turned.T, strict=True)
        if own.any()
    ]
    in_units = read.with_corrected_readings(encoders.values / size)
    complete = reads_angles and np.isfinite(encoders.values).any(axis=0).all()
    images = [s for s in evidence.sightings if s.name != "touch"] if complete else []
    beside = [select_images_beside_readings(in_units, one) for one in images]
    found = {
        name: _screen_encoder(
            name,
            encoders.t,
            y,
            partial(measure_motion_nats, in_units, beside, joint),
            partial(_measure_slip_nats_of_angles, in_units, images, joint, size),
        )
        for joint, (name, y) in enumerate(zip(body.joints, encoders.values.T, strict=True))
    }
    repaired = np.stack([one.values for one in found.values()], axis=1)
    # readings that screening left as they were stay exact
    same = repaired == angled.values
    screened, faults = refer_to_true_stretch(
        read.with_corrected_readings(np.where(same, read.values, repaired / size)),
        images,
        body.joints,
        [
            convert_fault_to_units(fault, evidence.unit, 1.0 / size)
            for one in found.values()
            for fault in one.faults
        ],
    )
    hypotheses = [
        Hypothesis(
            f"encoder {kind}", name, nats, EVIDENCE_THRESHOLD_NATS, nats > EVIDENCE_THRESHOLD_NATS
        )
        for name, one in found.items()
        for kind, nats in one.nats.items()
    ]
    return replace(
        evidence,
        encoders=screened,
        faults=(*evidence.faults, *sorted(faults, key=lambda fault: fault.since)),
        findings=(*evidence.findings, *findings),
        hypotheses=(*evidence.hypotheses, *hypotheses),
    )


def repair_readings(
    encoders: Encoders, images: Sequence[Sighting], joints: Sequence[str]
) -> Encoders:
    """The readings (angles) without faulty stretches and jumps, as they are where images show them
    to be true; those of joints that evidently stick as they are.
    """
    encoders = _unwrap_columns(encoders)
    each = [
        ScreenedEncoder(y, (), {})
        if len(find_evident_slips(encoders.t, y)) >= SURE_SLIPS
        else _screen_encoder(name, encoders.t, y, lambda begin, end: 0.0, lambda shifts: 0.0)
        for name, y in zip(joints, encoders.values.T, strict=True)
    ]
    repaired = _with_columns(encoders, [one.values for one in each])
    faults = [fault for one in each for fault in one.faults]
    return refer_to_true_stretch(repaired, images, joints, faults)[0]


def _unwrap_columns(encoders: Encoders) -> Encoders:
    return _with_columns(encoders, [unwrap_turns(y) for y in encoders.values.T])


def _with_columns(encoders: Encoders, columns: Sequence[Array]) -> Encoders:
    return encoders.with_corrected_readings(np.stack(columns, axis=1)) if columns else encoders


def _measure_slip_nats_of_angles(
    encoders: Encoders,
    images: Sequence[Sighting],
    joint: int,
    rad_per_unit: float,
    shifts: Sequence[tuple[int, float]],
) -> float:
    """`measure_slip_nats` of shifts in rad."""
    in_units = [(at, size / rad_per_unit) for at, size in shifts]
    return measure_slip_nats(encoders, images, joint, in_units)


def _screen_encoder(
    name: str,
    t: Array,
    y: Array,
    moved: Callable[[int, int], float],
    slipped: Callable[[Sequence[tuple[int, float]]], float],
) -> ScreenedEncoder:
    """Screen one encoder's readings y (N,) rad at t (N,) s.

    moved: nats of images that it moved in [begin, end) · slipped: nats of images that it slipped by
    each of these shifts (rad), from these readings on. Only jumps and glitches have a size.
    """
    if not np.isfinite(y).any():
        return ScreenedEncoder(y, (), {})
    values = y.copy()
    found = list[Fault]()
    nats: dict[str, float] = {FaultKind.FROZEN: 0.0, FaultKind.DEAD: 0.0, "jumped": 0.0}
    for one in (find_final_silence(t, y), *find_frozen_readings(t, y, moved)):
        nats[one.kind] = max(nats[one.kind], one.nats)
        if one.nats > EVIDENCE_THRESHOLD_NATS:
            since = float(t[one.begin])
            until = _find_recovery_time(t, y, one)
            found.append(Fault("encoders", name, one.kind, since, 0.0, "rad", until=until))
            values[one.begin : one.end] = np.nan
    moves = find_level_shifts(t, values)
    evident = [(at, size) for at, size, won in moves if won > EVIDENCE_THRESHOLD_NATS]
    least = 0.0 if evident and len(find_evident_slips(t, values)) else EVIDENCE_THRESHOLD_NATS
    if evident and slipped(evident) > least:
        return ScreenedEncoder(values, found, nats)
    nats["jumped"] = max((won for *_, won in moves), default=0.0)
    for begin, end, size in _find_excursions(t, values, moves):
        since = float(t[begin])
        until = float(t[end])
        found.append(Fault("encoders", name, FaultKind.GLITCH, since, size, "rad", until=until))
        values[begin:end] = np.nan
    for at, size, std in find_jumps(t, values):
        found.append(Fault("encoders", name, FaultKind.JUMPING, float(t[at]), size, "rad", std))
        values[at:] -= size
    return ScreenedEncoder(values, found, nats)


def _find_recovery_time(t: Array, y: Array, repeated: RepeatedReadings) -> float | None:
    """When (s) an encoder that was repeated reads again; None if it never does."""
    later = np.flatnonzero(np.isfinite(y[repeated.end :]))
    if len(later) == 0 or repeated.end == repeated.begin:
        return None
    return float(t[repeated.end + later[0]])


def _find_excursions(
    t: Array, y: Array, moves: Sequence[tuple[int, float, float]]
) -> list[tuple[int, int, float]]:
    """Short stretches [begin, end) of readings y (N,) before a jump, from the first reading, a gap
    or another jump on, and their shifts (rad).

    Such as a driver's zeros before its first reading: the readings after them are sound. Jumps are
    those of the `moves` that win EVIDENCE_THRESHOLD_NATS.
    """
    jumps = {at: size for at, size, nats in moves if nats > EVIDENCE_THRESHOLD_NATS}
    if not jumps:
        return []
    begins = sorted({*jumps, *index_resumed_readings(t, y).tolist()})
    return [
        (begin, end, jumps.get(begin, -jumps[end]))
        for begin, end in pairwise(begins)
        if end in jumps and t[end] - t[begin] < LONG_SILENCE_S
    ]
