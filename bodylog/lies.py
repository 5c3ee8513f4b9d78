"""Which sensor lied, as remarks."""

from collections.abc import Sequence

from .types import Fault, Finding

FIRST = 1.0
"""s: an encoder that is certainly off so soon was so before."""


def named(faults: Sequence[Fault]) -> tuple[Finding, ...]:
    """Which sensor lied, as remarks."""
    first = "; from the first on: homed differently, or the camera has moved since the body was learned"
    said = (
        f"{f.sense} {f.name}: {f.kind} since {f.since:.3f} s, {f.size:.4g} {f.unit}"
        + first * (f.kind == "drifting" and f.since < FIRST)
        for f in faults
    )
    return tuple(Finding("warning", text) for text in said)
