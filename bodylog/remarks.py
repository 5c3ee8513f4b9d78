"""What the pipeline remarks on beside its results: sensors that lied, and why there is no error against truth."""

from collections.abc import Sequence

from .types import Estimate, Fault, Features, Finding, Series

FIRST = 1.0
"""s: an encoder that is certainly off so soon was so before."""


def named(faults: Sequence[Fault]) -> tuple[Finding, ...]:
    """Which sensor lied, how, since when and how much."""
    first = "; from the first on: homed differently, or the camera has moved since the body was learned"
    said = (
        f"{f.sense} {f.name}: {f.kind} since {f.since:.3f} s, {f.size:.4g} {f.unit}"
        + first * (f.kind == "drifting" and f.since < FIRST)
        for f in faults
    )
    return tuple(Finding("warning", text) for text in said)


def sightings(found: Features) -> tuple[Finding, ...]:
    """In how many images each track was seen, and why not in the others, by reason."""
    from .body import taught

    return tuple(Finding("info", f"{name}: {taught.seen([found], name)}") for name in found.tracks)


def untold(found: Estimate, truth: Series | None) -> tuple[Finding, ...]:
    """A remark where there is no error against truth: no truth, or truth of other joints than the estimate's."""
    if truth is None:
        return (Finding("warning", "no truth topic, so no error against truth; name one in [topics] truth"),)
    if set(truth.names) & set(found.joints.names):
        return ()
    names = f"the truth is of {', '.join(truth.names)}, the estimate of {', '.join(found.joints.names)}"
    return (Finding("warning", f"{names}, so no error against truth; name another in [topics] truth"),)
