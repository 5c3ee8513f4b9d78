"""Encoder faults that show in the readings alone: frozen, dead and jumping encoders and glitches, joint by joint.

Offsets, which need the other senses, are found by `encoder_offset`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Fault, Finding, Hypothesis
from ..measurements.records import Encoders, Evidence
from .jumping import jumps, shifts, unwrapped
from .repeats import FROZEN, silence, stuck
from .stalled import motion_nats
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
    images = [s for s in evidence.sightings if s.name != "touch"] if angles else []
    each = [
        _screened(encoders.t, y, partial(motion_nats, encoders, images, joint), angles)
        for joint, y in enumerate(encoders.values.T)
    ]
    named = list(zip(body.joints, each, strict=True))
    faults = [Fault("encoders", name, *fault, "rad") for name, one in named for fault in one.faults]
    hypotheses = [
        Hypothesis(f"encoder {kind}", name, nats, NATS, nats > NATS)
        for name, one in named for kind, nats in one.nats.items()
    ]  # fmt: skip
    findings = [
        Finding("info", f"encoders: {name} wraps by a whole turn at {one.wraps:.3f} s; its angle is unwrapped")
        for name, one in named if one.wraps is not None
    ]  # fmt: skip
    return replace(
        evidence,
        encoders=_with_readings(encoders, each),
        faults=(*evidence.faults, *sorted(faults, key=lambda fault: fault.since)),
        findings=(*evidence.findings, *findings),
        hypotheses=(*evidence.hypotheses, *hypotheses),
    )


def repaired(encoders: Encoders) -> Encoders:
    """The readings (angles) without faulty stretches and jumps."""
    return _with_readings(encoders, [_screened(encoders.t, y) for y in encoders.values.T])


def _with_readings(encoders: Encoders, each: Sequence[Screened]) -> Encoders:
    return replace(encoders, values=np.stack([one.values for one in each], axis=1)) if each else encoders


def _screened(
    t: Array, y: Array, moved: Callable[[int, int], float] = lambda begin, end: 0.0, angles: bool = True
) -> Screened:  # fmt: skip
    """Screen one encoder's readings y (N,) rad at t (N,) s; `moved`: nats of images that it moved in [begin, end).

    Only jumps and glitches have a size.
    """
    if not np.isfinite(y).any():
        return Screened(y, (), {}, None)
    values = unwrapped(y) if angles else y.copy()
    turned = np.abs(values - y) > 1.0
    found, nats = list[tuple[str, float, float]](), {"frozen": 0.0, "dead": 0.0, "jumped": 0.0}
    for one in list(stuck(t, values, moved)):
        nats[one.kind] = max(nats[one.kind], one.nats)
        if one.nats > NATS:
            found.append((one.kind, float(t[one.begin]), 0.0))
            values[one.begin : one.end] = np.nan
    last, silent = silence(t, y)
    nats["dead"] = max(nats["dead"], silent)
    if silent > NATS:
        found.append(("dead", last, 0.0))
    moves = shifts(t, values)
    nats["jumped"] = max((won for *_, won in moves), default=0.0)
    for begin, end, size in _excursions(t, values, moves):
        found.append(("glitch", float(t[begin]), size))
        values[begin:end] = np.nan
    for at, size in jumps(t, values):
        found.append(("jumping", float(t[at]), size))
        values[at:] -= size
    return Screened(values, found, nats, float(t[int(turned.argmax())]) if turned.any() else None)


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
