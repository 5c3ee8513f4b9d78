"""Records of a claim and of what each reading does to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

KEPT = "kept"
REFUTED = "refuted"
UNTESTED = "not tested"
"""What a reading does to a claim, and a claim's verdict where all readings that test it agree."""
DEPENDS = "depends on"
UNTESTABLE = "not testable here"
OWN_HOLDS = "holds"
OWN_FAILS = "does not hold"


@dataclass(frozen=True)
class Bound:
    """The bound of a figure for the claim to hold: at most or at least a limit."""

    sign: str
    limit: float

    def kept(self, figures: Sequence[float]) -> tuple[bool, ...]:
        """Which of the figures are within the bound; one that is not a number is not."""
        values = np.asarray(figures, float)
        return tuple((values <= self.limit if self.sign == "≤" else values >= self.limit).tolist())

    def __str__(self) -> str:
        """As read on the page."""
        return f"{self.sign} {self.limit:g}"


@dataclass(frozen=True)
class Control:
    """A condition for a reading to test a claim: a figure's name and its bound."""

    measured: str
    unit: str
    bound: Bound
    figure: str


@dataclass(frozen=True)
class Outcome:
    """One reading's result: figures by seed, their median
    and its 95 % interval, and what they do to the claim.

    tested_seeds: seeds in which the model ran and every control holds · kept_seeds: those of them
    that keep the claim · state: kept, refuted or not tested · reason: why it is not kept.
    """

    figures: tuple[float, ...]
    median: float
    interval: tuple[float, float]
    tested_seeds: int
    kept_seeds: int
    state: str
    reason: str = ""


@dataclass(frozen=True)
class Counts:
    """In how many readings a claim is kept, refuted, and not tested."""

    kept: int = 0
    refuted: int = 0
    untested: int = 0

    def __str__(self) -> str:
        """As read on the page."""
        return f"{KEPT} in {self.kept}, {REFUTED} in {self.refuted}, {UNTESTED} in {self.untested}"


@dataclass(frozen=True)
class Claim:
    """One sentence judged. kind: paper, own, comparison or erratum.

    outcomes {reading: Outcome} decide, counts are theirs, reasons say why readings do not keep the
    claim; sweeps {constant: [(number, Outcome)]} show where the verdict changes; `turns` is that as
    text. For a claim of our own, outcomes has one entry, of our default; of a comparison, the last
    entry decides and is counted.
    """

    id: str
    kind: str
    text: str
    measured: str
    unit: str
    bound: str
    verdict: str
    outcomes: Mapping[str, Outcome]
    counts: Counts
    reasons: tuple[str, ...] = ()
    controls: tuple[str, ...] = ()
    sweeps: Mapping[str, tuple[tuple[float, Outcome], ...]] = field(default_factory=dict)
    turns: str = ""
    explanation: str = ""
    shared: str = ""
    differences: str = ""
