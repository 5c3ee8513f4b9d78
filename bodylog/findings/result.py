"""The result of a command, and that of an estimate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..types import Estimate, Fault, Finding, Health, Recording, Score
from . import headline, verdict
from .scoring import list_bounded_figures, score_estimate


class Scores(tuple[Score, ...]):
    """Scores in order, each of which is also found by its name: `scores["rmse/joint"].value`."""

    def __getitem__(self, key: Any) -> Any:
        """A score by its name or number; KeyError for a name that is not there."""
        if not isinstance(key, str):
            return super().__getitem__(key)
        found = next((score for score in self if score.name == key), None)
        if found is None:
            raise KeyError(f"{key}; there are {', '.join(self.keys()) or 'none'}")
        return found

    def __contains__(self, key: object) -> bool:
        """Whether there is such a score, or one of such a name."""
        return key in self.keys() if isinstance(key, str) else super().__contains__(key)

    def keys(self) -> list[str]:
        """The names."""
        return [score.name for score in self]

    def values(self) -> list[Score]:
        """The scores."""
        return list(self)

    def items(self) -> list[tuple[str, Score]]:
        """Names and scores."""
        return [(score.name, score) for score in self]

    def get(self, name: str, default: Score | None = None) -> Score | None:
        """A score by its name, or the default."""
        return next((score for score in self if score.name == name), default)


NO_SCORES = Scores()


@dataclass(frozen=True, eq=False)
class Result:
    """The result of a command: file written, scores, health
    per topic, findings, faults, verdict in sentences.

    `scores["rmse/joint"]` finds one by its name. `figures` are all that a bound may name: scores,
    faults, delays, shares used. `headline` names an estimate's main figures, each with its text, as
    a report's cards show them.
    """

    output: Path | None
    scores: Scores = NO_SCORES
    health: Mapping[str, Health] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    figures: Scores = NO_SCORES
    verdict: tuple[str, ...] = ()
    headline: Mapping[str, str] = field(default_factory=dict)


def estimate_result(
    out: Path,
    found: Estimate,
    read: Recording,
    health: Mapping[str, Health],
    findings: Sequence[Finding],
) -> Result:
    """An estimate's result: its scores, all figures that bounds may name, and its verdict."""
    scores = score_estimate(found, read)
    return Result(
        out,
        Scores(scores),
        health,
        tuple(findings),
        dict(found.settings),
        found.faults,
        figures=Scores(list_bounded_figures(found, scores)),
        verdict=verdict.verdict_of_estimate(found, scores),
        headline=headline.headline_of_estimate(found, scores),
    )
