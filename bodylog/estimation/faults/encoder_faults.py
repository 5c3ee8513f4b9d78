"""Encoder faults that show in the readings alone: frozen, dead and jumping encoders.

Each kind has a file of its own. Offsets, which need the other senses, are found by `bias`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...types import Array, Fault, Finding
from ..measurements.records import Encoders, Evidence
from .contract import Verdict
from .dead import dropped_to_zero, silent_since
from .frozen import frozen
from .jumping import jumps, unwrapped
from .repeat_evidence import weighed
from .stalled import Stall, stalled


def detect(evidence: Evidence, body: BodyModel) -> Verdict:
    """Detect frozen, dead and jumping encoders; whole turns are unwrapped only where encoders read angles."""
    if evidence.encoders is None:
        return Verdict(evidence)
    angles = "encoders" not in body.senses
    findings = tuple(wrap_findings(evidence.encoders, body.joints)) if angles else ()
    stalls = list(stalled(evidence.encoders, evidence.sightings)) if angles else []
    sound, faults = screen_encoders(evidence.encoders, body.joints, stalls, angles)
    hypotheses = tuple(weighed(evidence.encoders, body.joints, faults, {stall.joint: stall.nats for stall in stalls}))
    return Verdict(replace(evidence, encoders=sound), faults, findings, hypotheses)


def screen_encoders(
    encoders: Encoders, names: tuple[str, ...], stalls: Sequence[Stall] = (), angles: bool = True
) -> tuple[Encoders, tuple[Fault, ...]]:
    """Remove frozen and dead stretches, undo jumps, and return the encoders and faults (size 0 except for jumps).

    An encoder that repeats exactly zero is dead from its first zero on. `stalls`: repeats that images contradict. Whole
    turns are unwrapped only for `angles`.
    """
    values, found = encoders.values.copy(), list[Fault]()
    for joint, begin, end, _ in stalls:
        kind, begin = _kind_of_repeat(values[:, joint], begin)
        values[begin:end, joint] = np.nan
        found.append(Fault("encoders", names[joint], kind, float(encoders.t[begin]), 0.0, "rad"))
    for joint, name in enumerate(names):
        column = values[:, joint]
        column[:] = unwrapped(column) if angles else column
        for kind, begin, end in _faulty_repeats(encoders.t, column):
            found.append(Fault("encoders", name, kind, float(encoders.t[begin]), 0.0, "rad"))
            column[begin:end] = np.nan
        if (since := silent_since(encoders.t, column)) is not None and not any(f.name == name for f in found):
            found.append(Fault("encoders", name, "dead", since, 0.0, "rad"))
        for at, size in jumps(encoders.t, column):
            found.append(Fault("encoders", name, "jumping", float(encoders.t[at]), size, "rad"))
            column[at:] -= size
    return replace(encoders, values=values), tuple(sorted(found, key=lambda fault: fault.since))


def _faulty_repeats(t: Array, y: Array) -> list[tuple[str, int, int]]:
    """Return the kind and stretch [begin, end) of faulty repeats in readings y (N,) at t (N,), in order."""
    found = {end: (*_kind_of_repeat(y, begin), end) for begin, end in frozen(t, y)}
    found |= {end: ("dead", begin, end) for begin, end in dropped_to_zero(t, y)}
    return sorted(found.values(), key=lambda run: run[1])


def _kind_of_repeat(y: Array, begin: int) -> tuple[str, int]:
    """Kind of fault of an encoder y (N,) that repeats itself from index `begin` on, and the first faulty index."""
    return ("dead", begin - 1) if y[begin] == 0.0 else ("frozen", begin)


def wrap_findings(encoders: Encoders, names: tuple[str, ...]) -> Iterator[Finding]:
    """Yield a remark for each encoder that wraps at a whole turn and is unwrapped."""
    for name, column in zip(names, encoders.values.T, strict=True):
        whole = unwrapped(column)
        if whole is not column and (apart := np.abs(whole - column) > 1.0).any():
            at = float(encoders.t[int(apart.argmax())])
            yield Finding("info", f"encoders: {name} wraps by a whole turn at {at:.3f} s; its angle is unwrapped")
