"""Judge claims: in every reading over all seeds, with the controls that a reading must pass to test the claim."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import comb

import numpy as np

from . import readings
from .readings import CENTRE, CONSTANTS

SHARE = 0.9
"""A reading keeps a claim when at least this share of the seeds does."""
FEWEST = 3
"""Readings that must be tried before a claim may fail."""
HOLDS, DEPENDS, FAILS = "holds in every reading", "depends on", "fails in every reading tried"
FEW, UNTESTABLE = "fails, but in fewer than three readings", "not testable here"
OWN_HOLDS, OWN_FAILS = "holds", "does not hold"
CONFIDENCE = 0.95


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
    """One reading's result: figures by seed, their median and its 95 % interval, share of seeds that keep the claim.

    control: the share of seeds in which the controls hold; `share` counts seeds in which both do.
    """

    figures: tuple[float, ...]
    median: float
    interval: tuple[float, float]
    share: float
    control: float
    keeps: bool


@dataclass(frozen=True)
class Claim:
    """One sentence judged. kind: paper, own or comparison.

    outcomes {reading: Outcome} decide; sweeps {constant: [(number, Outcome)]} show where the verdict changes; `turns`
    is that as text. For a claim of our own or a comparison, outcomes has one entry, of our default.
    """

    id: str
    kind: str
    text: str
    measured: str
    unit: str
    bound: str
    verdict: str
    outcomes: Mapping[str, Outcome]
    controls: tuple[str, ...] = ()
    sweeps: Mapping[str, tuple[tuple[float, Outcome], ...]] = field(default_factory=dict)
    turns: str = ""
    explanation: str = ""
    shared: str = ""
    differences: str = ""


Swept = tuple[str, float, str]
"""A constant, a number on its axis, and the key of that reading."""

Figures = Callable[[str, str], tuple[float, ...]]
"""(reading's key, figure's name) -> the figure of every seed."""


def paper(
    name: str, text: str, measured: str, unit: str, bound: Bound, figure: str, figures: Figures,
    tried: Sequence[str], swept: Sequence[Swept] = (), controls: Sequence[Control] = (), explanation: str = "",
) -> Claim:  # fmt: skip
    """A claim of the paper, judged in the readings `tried` (keys), with those that sweep one constant each."""
    outcomes = {key: outcome(bound, figure, figures, key, controls) for key in tried}
    swings = _swings(swept, lambda key: outcome(bound, figure, figures, key, controls))
    verdict, guilty = verdict_of(outcomes)
    swings = {name: found for name, found in swings.items() if name in guilty}
    texts = tuple(f"{c.measured}: {c.bound}{_unit(c.unit)}" for c in controls)
    text_of_turns = turns(outcomes, swings, guilty)
    return Claim(
        name, "paper", text, measured, unit, str(bound), verdict, outcomes, texts, swings, text_of_turns, explanation
    )


def own(
    name: str, text: str, measured: str, unit: str, bound: Bound, figures: Sequence[float], explanation: str = ""
) -> Claim:
    """A claim of our own, of our default alone."""
    found = _outcome(bound, figures, [True] * len(figures))
    verdict = OWN_HOLDS if found.keeps else OWN_FAILS
    return Claim(name, "own", text, measured, unit, str(bound), verdict, {"default": found}, (), {}, "", explanation)


def comparison(
    name: str, text: str, measured: str, unit: str, bound: Bound, figures: Mapping[str, Sequence[float]],
    shared: str, differences: str,
) -> Claim:  # fmt: skip
    """A comparison with others' figures, with the setup's shared and differing parts; the last figure decides."""
    found = {who: _outcome(bound, values, [True] * len(values)) for who, values in figures.items()}
    verdict = OWN_HOLDS if list(found.values())[-1].keeps else OWN_FAILS
    return Claim(
        name, "comparison", text, measured, unit, str(bound), verdict, found, shared=shared, differences=differences
    )


def erratum(
    name: str, text: str, measured: str, unit: str, bound: Bound, figures: Mapping[str, Sequence[float]],
    derivation: str,
) -> Claim:  # fmt: skip
    """An equation's effect as printed and as run here, with the derivation."""
    found = comparison(name, text, measured, unit, bound, figures, "", "")
    return replace(found, kind="erratum", explanation=derivation)


def variants(
    name: str, text: str, measured: str, unit: str, bound: Bound, figures: Mapping[str, Sequence[float]],
    apart: str, explanation: str = "",
) -> Claim:  # fmt: skip
    """A claim of the paper about no constant, judged in variants of its wording; `apart` is their difference."""
    found = {who: _outcome(bound, values, [True] * len(values)) for who, values in figures.items()}
    verdict = _varied([one.keeps for one in found.values()], apart)
    texts = "; ".join(f"{'kept' if one.keeps else 'not kept'}: {who}" for who, one in found.items())
    turns = texts if DEPENDS in verdict else ""
    return Claim(name, "paper", text, measured, unit, str(bound), verdict, found, turns=turns, explanation=explanation)


def _varied(kept: Sequence[bool], apart: str) -> str:
    if len(kept) == 1:
        return OWN_HOLDS if kept[0] else OWN_FAILS
    if all(kept):
        return HOLDS
    return f"{DEPENDS} {apart}" if any(kept) else FAILS if len(kept) >= FEWEST else FEW


def untestable(name: str, text: str, why: str) -> Claim:
    """A claim of the paper that no simulation can decide, and why."""
    return Claim(name, "paper", text, "", "1", "", UNTESTABLE, {}, explanation=why)


def outcome(bound: Bound, figure: str, figures: Figures, key: str, controls: Sequence[Control]) -> Outcome:
    """The outcome of a claim in one reading."""
    held = [control.bound.kept(figures(key, control.figure)) for control in controls]
    values = figures(key, figure)
    return _outcome(bound, values, [all(row) for row in zip(*held, strict=True)] if held else [True] * len(values))


def _outcome(bound: Bound, values: Sequence[float], controlled: Sequence[bool]) -> Outcome:
    both = [a and b for a, b in zip(bound.kept(values), controlled, strict=True)]
    share, control = (float(np.mean(found)) if found else 0.0 for found in (both, list(controlled)))
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    median = float(np.median(finite)) if len(finite) else float("nan")
    return Outcome(tuple(float(v) for v in values), median, interval(finite.tolist()), share, control, share >= SHARE)


def interval(values: Sequence[float]) -> tuple[float, float]:
    """A distribution-free interval of the median: order statistics that hold it with 95 %; all of few values."""
    ordered = sorted(values)
    n = len(ordered)
    if not n:
        return float("nan"), float("nan")
    inside, out = 1.0, 0
    while out + 1 <= (n - 1) // 2:
        inside -= 2.0 * comb(n, out) / 2.0**n
        if inside < CONFIDENCE:
            break
        out += 1
    return ordered[max(out - 1, 0)], ordered[n - 1 - max(out - 1, 0)]


def verdict_of(outcomes: Mapping[str, Outcome]) -> tuple[str, tuple[str, ...]]:
    """The verdict, and the constants it depends on: those that turn it alone, else those of the readings that do."""
    kept = {key: found.keeps for key, found in outcomes.items()}
    if all(kept.values()):
        return (HOLDS if len(kept) > 1 else OWN_HOLDS), ()
    if not any(kept.values()):
        return (FAILS if len(kept) >= FEWEST else FEW if len(kept) > 1 else OWN_FAILS), ()
    first = kept.get(CENTRE, next(iter(kept.values())))
    other = [readings.parsed(key) for key, keeps in kept.items() if keeps != first]
    fewest = min(len(reading) for reading in other)
    named = {name for reading in other if len(reading) == fewest for name in reading}
    guilty = tuple(name for name in CONSTANTS if name in named)
    return f"{DEPENDS} {', '.join(CONSTANTS[name].symbol for name in guilty)}", guilty


def turns(
    outcomes: Mapping[str, Outcome], swept: Mapping[str, Sequence[tuple[float, Outcome]]], guilty: Sequence[str]
) -> str:
    """Where the verdict changes: between which numbers of each constant, or for which of its values."""
    parts = []
    for name in guilty:
        found = [(a, b) for (a, x), (b, y) in pairwise(swept.get(name, ())) if x.keeps != y.keeps]
        symbol, unit = CONSTANTS[name].symbol, CONSTANTS[name].unit
        between = " and ".join(f"between {a:g} and {b:g}" for a, b in found)
        parts.append(f"{symbol}: {between} ({unit})" if found else f"{symbol}: {_valued(outcomes, name)}")
    return "; ".join(parts)


def _valued(outcomes: Mapping[str, Outcome], name: str) -> str:
    """Which values keep the claim, in the readings of this constant with the fewest others."""
    texts = []
    for key, found in outcomes.items():
        reading = readings.parsed(key)
        if name in reading or key == CENTRE:
            texts.append(f"{'kept' if found.keeps else 'not kept'} at {key}")
    return ", ".join(texts)


def _swings(swept: Sequence[Swept], found: Callable[[str], Outcome]) -> dict[str, tuple[tuple[float, Outcome], ...]]:
    by: dict[str, list[tuple[float, Outcome]]] = {}
    for name, number, key in swept:
        by.setdefault(name, []).append((number, found(key)))
    return {name: tuple(sorted(rows, key=lambda row: row[0])) for name, rows in by.items()}


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"
