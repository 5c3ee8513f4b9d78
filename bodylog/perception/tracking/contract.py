"""The interface of a source that reads frames, and its result."""

from typing import NamedTuple, Protocol

from ...types import Array, Finding

HIDDEN = "hidden"
UNDECODABLE = "undecodable picture"


class Tracked(NamedTuple):
    """What one tracker found in N frames, in the order they were added.

    values (N,K,4): u, v, std_u, std_v px of K tracks, NaN where not seen · reasons (N,) str: why
    nothing was seen in a frame, "" where something was.
    """

    names: tuple[str, ...]
    values: Array
    reasons: Array
    findings: tuple[Finding, ...] = ()


class Tracker(Protocol):
    """Tracks one thing, or several that are found together, through one camera's frames."""

    def add(self, gray: Array | None) -> None:
        """The next frame in the order of the file, (H,W) uint8; None where it cannot be decoded."""

    def tracked(self) -> Tracked:
        """What was found in all frames added."""
