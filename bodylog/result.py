"""The result of a command, and that of an estimate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import verdict
from .scoring import bounded
from .types import Estimate, Fault, Finding, Health, Score


@dataclass(frozen=True, eq=False)
class Result:
    """The result of a command: file written, scores, health per topic, findings, faults, verdict in sentences.

    `figures` are all that a bound may name: scores, faults, delays, shares used.
    """

    output: Path | None
    scores: tuple[Score, ...] = ()
    health: Mapping[str, Health] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    figures: tuple[Score, ...] = ()
    verdict: tuple[str, ...] = ()


def estimate_result(
    out: Path, found: Estimate, scores: tuple[Score, ...], health: Mapping[str, Health], findings: Sequence[Finding]
) -> Result:
    """An estimate's result with all figures that bounds may name, and its verdict."""
    figures, text = bounded(found, scores), verdict.of_estimate(found, scores)
    return Result(out, scores, health, tuple(findings), dict(found.settings), found.faults, figures, text)
