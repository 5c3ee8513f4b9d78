"""How sensors fail: every kind of fault, its words, its unit and its score; each stands here only.

A new kind is a member of `FaultKind` and a line of `FORMS`, beside the detector that finds it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from typing import NamedTuple

from .wording import quantity_text

ALTERNATIVE_SEPARATOR = " or "
"""Between the names of joints one of which is faulty."""
OFF_FROM_START_S = 1.0
"""s: an encoder that is certainly off this early was off from the start."""
ENCODER_OFFSET = "encoder_offset"
"""Name in scores of all kinds that are offsets of an encoder."""


class FaultKind(StrEnum):
    """A kind of fault, as outputs and scores call it."""

    DRIFTING = "drifting"
    JUMPING = "jumping"
    OFFSET = "offset"
    FROZEN = "frozen"
    DEAD = "dead"
    GLITCH = "glitch"
    DISPLACED = "displaced"
    MOVED = "moved"


class FaultForm(NamedTuple):
    """One kind of fault of one sense.

    words: the sentence after the sensor's name, with {size}, {since} (a span) and {at} ·
    words_unsized: where the size is unknown, None: as `words` · unit of its score where no fault is
    found, "" for that of its sensor · scored: as 0 where it is not found · offset: of an encoder ·
    needs_images: only they show it · by_body: only the learned body shows it.
    """

    words: str
    words_unsized: str | None = None
    unit: str = ""
    scored: bool = False
    offset: bool = False
    needs_images: bool = False
    by_body: bool = False


FORMS: Mapping[tuple[str, FaultKind], FaultForm] = {
    ("encoders", FaultKind.DRIFTING): FaultForm(
        "encoder drifts {since}, by {size}",
        "encoder drifts {since}",
        scored=True,
        offset=True,
        needs_images=True,
        by_body=True,
    ),
    ("encoders", FaultKind.JUMPING): FaultForm(
        "encoder jumps by {size} at {at}",
        "encoder jumps at {at}",
        scored=True,
        offset=True,
        by_body=True,
    ),
    ("encoders", FaultKind.OFFSET): FaultForm(
        "encoder is off by {size} {since}",
        "encoder is off {since}",
        scored=True,
        offset=True,
        needs_images=True,
        by_body=True,
    ),
    ("encoders", FaultKind.FROZEN): FaultForm("encoder is frozen {since}", unit="1", scored=True),
    ("encoders", FaultKind.DEAD): FaultForm("encoder is silent {since}", unit="1", scored=True),
    ("encoders", FaultKind.GLITCH): FaultForm("encoder is off by {size} {since}"),
    ("vision", FaultKind.FROZEN): FaultForm("its images are frozen {since}"),
    ("vision", FaultKind.DISPLACED): FaultForm(
        "camera moved {since}, by {size} in the image", unit="px", by_body=True
    ),
    ("vision", FaultKind.MOVED): FaultForm(
        "its centre moved since the body was learned, by {size}",
        "moved since the body was learned",
        by_body=True,
    ),
}
_FROM_START = FaultForm("encoder is off from the start, by {size}", "encoder is off from the start")
_UNTIL_JUMP = FaultForm("encoder is off by {size} {since}")
_TRACKER = FaultForm("tracker moved {since}, by {size}")
_TURNED = FaultForm("turned since the body was learned, by {size}")


@dataclass(frozen=True)
class Fault:
    """One sensor that lied: which joint or sense, what kind,
    since when (s), how much ± std (`unit`, None: unknown).

    until: when it ended (s); None where it lasts to the end of the log. An encoder that is true
    after a jump is jumping until then. turn ± turn_std: rad by which a board also
    turned, whose size is the displacement of its centre; None otherwise.
    """

    sense: str
    name: str
    kind: FaultKind
    since: float
    size: float
    unit: str
    std: float | None = None
    turn: float | None = None
    turn_std: float | None = None
    until: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The sensors one of which is faulty; a single one where the log tells which."""
        return tuple(self.name.split(ALTERNATIVE_SEPARATOR))

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Names, after the first, of those that explain the log alike."""
        return self.names[1:]

    @property
    def form(self) -> FaultForm:
        """What holds for every fault of this kind and sense."""
        return FORMS[self.sense, self.kind]

    @property
    def end(self) -> float:
        """When it ended (s); infinite where it lasts to the end of the log."""
        return inf if self.until is None else self.until

    @property
    def sized(self) -> bool:
        """Whether its size is known; it is NaN where the log does not tell which sensor it is."""
        return self.size == self.size


def span_text(fault: Fault, decimals: int = 1) -> str:
    """When a fault was there: "since 18.0 s", "18.0 to 21.0 s", or "for a moment at 18.0 s"."""
    begin = f"{fault.since:.{decimals}f}"
    end = None if fault.until is None else f"{fault.until:.{decimals}f}"
    if end == begin or (end is None and fault.kind == FaultKind.GLITCH):
        return f"for a moment at {begin} s"
    return f"since {begin} s" if end is None else f"{begin} to {end} s"


def fault_sentence(fault: Fault) -> str:
    """A fault as a verdict says it: "elbow: encoder drifts since 8.9 s, by 0.3 rad (17°)"."""
    form = fault.form
    if fault.kind == FaultKind.DRIFTING and fault.since < OFF_FROM_START_S:
        form = _FROM_START
    elif fault.kind == FaultKind.JUMPING and fault.until is not None:
        form = _UNTIL_JUMP
    elif fault.kind == FaultKind.MOVED and fault.unit == "rad" and fault.sized:
        form = _TURNED
    elif fault.kind == FaultKind.DISPLACED and fault.unit == "m":
        form = _TRACKER
    words = form.words if fault.sized or form.words_unsized is None else form.words_unsized
    at = f"{fault.since:.1f} s"
    text = f"{fault.name}: {words.format(size=_size_text(fault), since=span_text(fault), at=at)}"
    if fault.turn is not None and fault.sized:
        text += f" and turned by {_turn_text(fault)}"
    return text if fault.sized or not fault.alternatives else f"{text} (the log cannot tell which)"


def fault_warning(fault: Fault) -> str:
    """A fault as a warning says it: sense, name, kind, when, size, and against what it stands."""
    text = f"{fault.sense} {fault.name}: {fault.kind} {span_text(fault, 3)}"
    if fault.sized:
        text += f", {_size_text(fault)}"
    elif fault.alternatives:
        text += "; the log does not determine which one"
    if fault.turn is not None:
        text += f", turned by {_turn_text(fault)}"
    if fault.kind == FaultKind.DRIFTING and fault.since < OFF_FROM_START_S:
        text += (
            "; from the start: homed differently, or the camera moved since the body was learned"
        )
    since_learned = fault.kind == FaultKind.OFFSET and fault.std is not None
    return text + "; relative to the body" * (since_learned or fault.kind == FaultKind.MOVED)


def fault_headline(fault: Fault) -> str:
    """A fault in few words: "elbow drifting by 0.3 rad (17°)"."""
    sized = abs(fault.size) > 0.0
    return f"{fault.name} {fault.kind}" + f" by {_size_text(fault)}" * sized


def _size_text(fault: Fault) -> str:
    return quantity_text(fault.size, fault.std, fault.unit)


def _turn_text(fault: Fault) -> str:
    assert fault.turn is not None
    return quantity_text(fault.turn, fault.turn_std, "rad")
