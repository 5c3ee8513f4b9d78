"""Encoder faults that show in the readings alone: frozen, dead and jumping encoders and glitches, joint by joint.

Offsets, which need the other senses, are found by `encoder_offset`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Fault, Finding, Hypothesis
from ..measurements.records import Encoders, Evidence
from .jumping import jumps, shifts, unwrapped
from .repeats import FROZEN, dropped_to_zero, frozen, repeat_nats, silence_nats, silent_since
from .stalled import Stall, stalled
from .threshold import NATS


class Screened(NamedTuple):
    """One encoder: readings (N,) rad without faulty stretches and jumps, its faults (kind, since s, size rad), the nats
    won by each kind, and since when (s) it is unwrapped by a whole turn.
    """

    values: Array
    faults: Sequence[tuple[str, float, float]]
    nats: Mapping[str, float]
    wraps: float | None


def detect(evidence: Evidence, body: BodyModel) -> Evidence:
    """Remove frozen and dead stretches and glitches, undo jumps, and unwrap whole turns where encoders read angles."""
    encoders = evidence.encoders
    if encoders is None:
        return evidence
    angles = "encoders" not in body.senses
    stalls = list(stalled(encoders, evidence.sightings)) if angles else []
    faults, findings, hypotheses = list[Fault](), list[Finding](), list[Hypothesis]()
    own = [[stall for stall in stalls if stall.joint == joint] for joint in range(len(body.joints))]
    each = [_screened(encoders.t, y, those, angles) for y, those in zip(encoders.values.T, own, strict=True)]
    for name, one in zip(body.joints, each, strict=True):
        faults += [Fault("encoders", name, *fault, "rad") for fault in one.faults]
        kinds = {"jumping" if kind == "glitch" else kind for kind, *_ in one.faults}
        hypotheses += [
            Hypothesis(f"encoder {'jumped' if kind == 'jumping' else kind}", name, nats, NATS, kind in kinds)
            for kind, nats in one.nats.items()
        ]
        if one.wraps is not None:
            text = f"encoders: {name} wraps by a whole turn at {one.wraps:.3f} s; its angle is unwrapped"
            findings.append(Finding("info", text))
    faults.sort(key=lambda fault: fault.since)
    return replace(
        evidence,
        encoders=_with_readings(encoders, each),
        faults=(*evidence.faults, *faults),
        findings=(*evidence.findings, *findings),
        hypotheses=(*evidence.hypotheses, *hypotheses),
    )


def repaired(encoders: Encoders) -> Encoders:
    """The readings (angles) without faulty stretches and jumps."""
    return _with_readings(encoders, [_screened(encoders.t, y) for y in encoders.values.T])


def _with_readings(encoders: Encoders, each: Sequence[Screened]) -> Encoders:
    return replace(encoders, values=np.stack([one.values for one in each], axis=1)) if each else encoders


def _screened(t: Array, y: Array, stalls: Sequence[Stall] = (), angles: bool = True) -> Screened:
    """Screen one encoder's readings y (N,) rad at t (N,) s; `stalls`: its repeats that images contradict.

    An encoder that repeats exactly zero is dead from its first zero on. Only jumps and glitches have a size.
    """
    if not np.isfinite(y).any():
        return Screened(y, (), {}, None)
    values, found = (unwrapped(y) if angles else y).copy(), list[tuple[str, float, float]]()
    turned = np.abs(values - y) > 1.0
    for kind, begin, end in _faulty_repeats(t, values, stalls):
        found.append((kind, float(t[begin]), 0.0))
        values[begin:end] = np.nan
    if not found and (since := silent_since(t, values)) is not None:
        found.append(("dead", since, 0.0))
    moves = shifts(t, values)
    for begin, end, size in _excursions(t, values, moves):
        found.append(("glitch", float(t[begin]), size))
        values[begin:end] = np.nan
    for at, size in jumps(t, values):
        found.append(("jumping", float(t[at]), size))
        values[at:] -= size
    repeated, value = repeat_nats(y)
    won = {
        "frozen": max([repeated if value else min(repeated, 0.0), *(stall.nats for stall in stalls)]),
        "dead": max(silence_nats(y), repeated if value == 0.0 else -np.inf),
        "jumping": max((nats for *_, nats in moves), default=0.0),
    }
    return Screened(values, found, won, float(t[int(turned.argmax())]) if turned.any() else None)


def _excursions(t: Array, y: Array, moves: Sequence[tuple[int, float, float]]) -> list[tuple[int, int, float]]:
    """Short stretches [begin, end) of readings y (N,) before the first jump or between two, and their shifts (rad).

    Such as a driver's zeros before its first reading: the readings after them are sound. Jumps are those of the `moves`
    that win NATS.
    """
    edges = [(at, size) for at, size, nats in moves if nats > NATS]
    if not edges:
        return []
    stretches = pairwise([(int(np.isfinite(y).argmax()), -edges[0][1]), *edges])
    return [(begin, end, size) for (begin, size), (end, _) in stretches if t[end] - t[begin] < FROZEN]


def _faulty_repeats(t: Array, y: Array, stalls: Sequence[Stall]) -> list[tuple[str, int, int]]:
    """Return the kind and stretch [begin, end) of faulty repeats in readings y (N,) at t (N,), in order."""
    runs = [*((stall.begin, stall.end) for stall in stalls), *frozen(t, y)]
    # dead from the first zero on
    found = {end: ("dead", begin - 1, end) if y[begin] == 0.0 else ("frozen", begin, end) for begin, end in runs}
    found |= {end: ("dead", begin, end) for begin, end in dropped_to_zero(t, y)}
    return sorted(found.values(), key=lambda run: run[1])
