"""Bounds on scores, as typed after --fail-if: 'joint_rmse>0.02' fails when the score is above."""

import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ..errors import BoundError, UsageError
from ..types import Score

COMPARE: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}


@dataclass(frozen=True)
class Bound:
    """Fails when the score `name` compares so with `limit`."""

    name: str
    sign: str
    limit: float


def parse(text: str) -> Bound:
    """A bound as typed; UsageError when it is not NAME, sign and number."""
    found = re.fullmatch(r"\s*([\w./:\-]+)\s*(>=|<=|>|<)\s*([-+0-9.eE]+)\s*", text)
    try:
        return Bound(found[1], found[2], float(found[3])) if found else _refuse(text)
    except ValueError:
        return _refuse(text)


def _refuse(text: str) -> Bound:
    raise UsageError(f"--fail-if {text!r}: not a bound; type a score, a sign and a number, e.g. 'joint_rmse>0.02'")


def check(scores: Mapping[str, Sequence[Score]], bounds: Sequence[Bound]) -> None:
    """BoundError naming each broken bound; UsageError when a log has no such score. A NaN score breaks its bound."""
    broken = [text for path, found in scores.items() for bound in bounds if (text := _broken(path, found, bound))]
    if broken:
        raise BoundError("; ".join(broken))


def _broken(path: str, scores: Sequence[Score], bound: Bound) -> str | None:
    values = {score.name: score.value for score in scores}
    if bound.name not in values:
        raise UsageError(f"{path}: no score {bound.name!r} to bound; possible: {', '.join(sorted(values))}")
    value = values[bound.name]
    holds = value == value and not COMPARE[bound.sign](value, bound.limit)
    return None if holds else f"{path}: {bound.name} is {value:.6g}, bound broken: {bound.sign} {bound.limit:g}"
