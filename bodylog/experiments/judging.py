"""Judge claims in each reading over all seeds: kept, refuted, not tested where a control fails."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import comb

import numpy as np

from . import readings
from .claims import (
    DEPENDS,
    KEPT,
    OWN_FAILS,
    OWN_HOLDS,
    REFUTED,
    UNTESTABLE,
    UNTESTED,
    Bound,
    Claim,
    Control,
    Counts,
    Outcome,
)
from .readings import CENTRE, CONSTANTS

DECIDING_SHARE = 0.9
"""Share of the seeds that decides: so many must test a
claim in a reading, and so many of those must keep it.
"""
CONFIDENCE = 0.95
DIVERGED = "the model diverged"

Swept = tuple[str, float, str]
"""A constant, a number on its axis, and the key of that reading."""

Figures = Callable[[str, str], tuple[float, ...]]
"""(reading's key, figure's name) -> the figure of every seed."""


def judge_paper_claim(
    name: str,
    text: str,
    measured: str,
    unit: str,
    bound: Bound,
    figure: str,
    figures: Figures,
    tried: Sequence[str],
    swept: Sequence[Swept] = (),
    controls: Sequence[Control] = (),
    explanation: str = "",
) -> Claim:
    """A claim of the paper, judged in the readings `tried`
    (keys), with those that sweep one constant each.
    """
    outcomes = {key: judge_reading(bound, figure, figures, key, controls) for key in tried}
    swings = _group_swept_outcomes(
        swept, lambda key: judge_reading(bound, figure, figures, key, controls)
    )
    verdict, guilty = verdict_of(outcomes)
    swings = {name: found for name, found in swings.items() if name in guilty}
    texts = tuple(f"{c.measured}: {c.bound}{_unit_suffix(c.unit)}" for c in controls)
    return Claim(
        name,
        "paper",
        text,
        measured,
        unit,
        str(bound),
        verdict,
        outcomes,
        count_states(outcomes),
        list_reasons(outcomes),
        texts,
        swings,
        describe_turning_points(outcomes, swings, guilty),
        explanation,
    )


def judge_own_claim(
    name: str,
    text: str,
    measured: str,
    unit: str,
    bound: Bound,
    figures: Sequence[float],
    explanation: str = "",
) -> Claim:
    """A claim of our own, of our default alone; a belief that diverged refutes it."""
    outcomes = {"default": _judge_all_seeds(bound, figures)}
    return _decide_by_last_outcome("own", name, text, measured, unit, bound, outcomes, explanation)


def judge_comparison(
    name: str,
    text: str,
    measured: str,
    unit: str,
    bound: Bound,
    figures: Mapping[str, Sequence[float]],
    shared: str,
    differences: str,
) -> Claim:
    """A comparison with others' figures, with the setup's
    shared and differing parts; the last figure decides.
    """
    outcomes = {who: _judge_all_seeds(bound, values) for who, values in figures.items()}
    claim = _decide_by_last_outcome("comparison", name, text, measured, unit, bound, outcomes)
    return replace(claim, shared=shared, differences=differences)


def judge_erratum(
    name: str,
    text: str,
    measured: str,
    unit: str,
    bound: Bound,
    figures: Mapping[str, Sequence[float]],
    derivation: str,
) -> Claim:
    """An equation's effect as printed and, last, as run here, with the derivation."""
    outcomes = {who: _judge_all_seeds(bound, values) for who, values in figures.items()}
    return _decide_by_last_outcome(
        "erratum", name, text, measured, unit, bound, outcomes, derivation
    )


def _decide_by_last_outcome(
    kind: str,
    name: str,
    text: str,
    measured: str,
    unit: str,
    bound: Bound,
    outcomes: Mapping[str, Outcome],
    explanation: str = "",
) -> Claim:
    """A claim that its last outcome decides."""
    who, last = list(outcomes.items())[-1]
    verdict = OWN_HOLDS if last.state == KEPT else OWN_FAILS
    decisive = {who: last}
    return Claim(
        name,
        kind,
        text,
        measured,
        unit,
        str(bound),
        verdict,
        outcomes,
        count_states(decisive),
        list_reasons(decisive),
        explanation=explanation,
    )


def judge_variants(
    name: str,
    text: str,
    measured: str,
    unit: str,
    bound: Bound,
    figures: Mapping[str, Sequence[float]],
    apart: str,
    explanation: str = "",
) -> Claim:
    """A claim of the paper about no constant, judged in
    variants of its wording; `apart` is their difference.
    """
    outcomes = {who: _judge_all_seeds(bound, values) for who, values in figures.items()}
    states = {one.state for one in outcomes.values()}
    verdict = f"{DEPENDS} {apart}" if len(states) > 1 else states.pop()
    texts = "; ".join(f"{one.state}: {who}" for who, one in outcomes.items())
    return Claim(
        name,
        "paper",
        text,
        measured,
        unit,
        str(bound),
        verdict,
        outcomes,
        count_states(outcomes),
        list_reasons(outcomes),
        turns=texts if DEPENDS in verdict else "",
        explanation=explanation,
    )


def untestable_claim(name: str, text: str, why: str) -> Claim:
    """A claim of the paper that no simulation can decide, and why."""
    reasons = (f"{UNTESTED}: {why}",)
    return Claim(
        name, "paper", text, "", "1", "", UNTESTABLE, {}, Counts(), reasons, explanation=why
    )


def judge_reading(
    bound: Bound, figure: str, figures: Figures, key: str, controls: Sequence[Control]
) -> Outcome:
    """What one reading does to a claim.

    A seed in which the model diverges or a control fails does not test the claim. A reading tests
    it where nine of ten seeds do, and keeps it where nine of ten of those do.
    """
    values = figures(key, figure)
    failures = {DIVERGED: [bool(np.isnan(value)) for value in values]}
    for control in controls:
        found = figures(key, control.figure)
        kept = control.bound.kept(found)
        failed = [
            not good and not gone for good, gone in zip(kept, failures[DIVERGED], strict=True)
        ]
        where = (
            np.median([value for value, bad in zip(found, failed, strict=True) if bad])
            if any(failed)
            else 0.0
        )
        text = (
            f"{control.measured} is {where:.3g}{_unit_suffix(control.unit)} and must be "
            f"{control.bound}"
        )
        failures[text] = failed
    tested = [not any(column) for column in zip(*failures.values(), strict=True)]
    return _judge_outcome(
        bound, values, tested, {text: sum(failed) for text, failed in failures.items()}
    )


def _judge_all_seeds(bound: Bound, values: Sequence[float]) -> Outcome:
    """What figures do to a claim that every seed tests."""
    return _judge_outcome(bound, values, [True] * len(values), {})


def _judge_outcome(
    bound: Bound, values: Sequence[float], tested: Sequence[bool], failures: Mapping[str, int]
) -> Outcome:
    seeds = len(values)
    tests = sum(tested)
    keeps = sum(kept and sound for kept, sound in zip(bound.kept(values), tested, strict=True))
    numbers = [float(value) for value in values if not np.isnan(value)]
    median = float(np.median(numbers)) if numbers else float("nan")
    if tests < DECIDING_SHARE * seeds:
        state = UNTESTED
        found = [
            f"{text}, in {count} of {seeds} seeds" for text, count in failures.items() if count
        ]
        reason = "; ".join(found)
    else:
        state = KEPT if keeps >= DECIDING_SHARE * tests else REFUTED
        reason = "" if state == KEPT else f"{median:.3g}, kept by {keeps} of {tests} seeds"
    return Outcome(
        tuple(map(float, values)), median, median_interval(numbers), tests, keeps, state, reason
    )


def count_states(outcomes: Mapping[str, Outcome]) -> Counts:
    """In how many of the readings the claim is kept, refuted and not tested."""
    states = [one.state for one in outcomes.values()]
    return Counts(*(states.count(state) for state in (KEPT, REFUTED, UNTESTED)))


def list_reasons(outcomes: Mapping[str, Outcome]) -> tuple[str, ...]:
    """Why readings refute or do not test a claim: a text
    for each reason, with the readings that have it.
    """
    groups: dict[tuple[str, str], list[str]] = {}
    for state in (REFUTED, UNTESTED):
        for key, one in outcomes.items():
            if one.state == state:
                groups.setdefault((state, one.reason), []).append(key)
    return tuple(
        f"{state} at {'; '.join(keys)}: {reason}" for (state, reason), keys in groups.items()
    )


def median_interval(values: Sequence[float]) -> tuple[float, float]:
    """A distribution-free interval of the median: order
    statistics that hold it with 95 %; all of few values.
    """
    ordered = sorted(values)
    n = len(ordered)
    if not n:
        return float("nan"), float("nan")
    inside = 1.0
    out = 0
    while out + 1 <= (n - 1) // 2:
        inside -= 2.0 * comb(n, out) / 2.0**n
        if inside < CONFIDENCE:
            break
        out += 1
    return ordered[max(out - 1, 0)], ordered[n - 1 - max(out - 1, 0)]


def verdict_of(outcomes: Mapping[str, Outcome]) -> tuple[str, tuple[str, ...]]:
    """The verdict over the readings that test a claim, and the constants it depends on.

    These are the constants that change the verdict alone,
    else those of the readings with the fewest that do.
    """
    states = {key: found.state for key, found in outcomes.items() if found.state != UNTESTED}
    if not states:
        return UNTESTED, ()
    first = states.get(CENTRE, next(iter(states.values())))
    other = [readings.parse_reading(key) for key, state in states.items() if state != first]
    if not other:
        return first, ()
    fewest = min(len(reading) for reading in other)
    named = {name for reading in other if len(reading) == fewest for name in reading}
    guilty = tuple(name for name in CONSTANTS if name in named)
    return f"{DEPENDS} {', '.join(CONSTANTS[name].symbol for name in guilty)}", guilty


def describe_turning_points(
    outcomes: Mapping[str, Outcome],
    swept: Mapping[str, Sequence[tuple[float, Outcome]]],
    guilty: Sequence[str],
) -> str:
    """Where the verdict changes: between which tested
    numbers of each constant, or for which of its values.
    """
    parts = []
    for name in guilty:
        tested = [
            (number, one.state) for number, one in swept.get(name, ()) if one.state != UNTESTED
        ]
        found = [(a, b) for (a, x), (b, y) in pairwise(tested) if x != y]
        symbol = CONSTANTS[name].symbol
        unit = CONSTANTS[name].unit
        between = " and ".join(f"between {a:g} and {b:g}" for a, b in found)
        parts.append(
            f"{symbol}: {between} ({unit})"
            if found
            else f"{symbol}: {_describe_values(outcomes, name)}"
        )
    return "; ".join(parts)


def _describe_values(outcomes: Mapping[str, Outcome], name: str) -> str:
    """What each reading of this constant, and the centre, does to the claim."""
    texts = []
    for key, found in outcomes.items():
        if key == CENTRE or name in readings.parse_reading(key):
            texts.append(f"{found.state} at {key}")
    return ", ".join(texts)


def _group_swept_outcomes(
    swept: Sequence[Swept], found: Callable[[str], Outcome]
) -> dict[str, tuple[tuple[float, Outcome], ...]]:
    by: dict[str, list[tuple[float, Outcome]]] = {}
    for name, number, key in swept:
        by.setdefault(name, []).append((number, found(key)))
    return {name: tuple(sorted(rows, key=lambda row: row[0])) for name, rows in by.items()}


def _unit_suffix(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"
