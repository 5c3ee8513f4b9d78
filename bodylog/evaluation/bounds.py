"""Bounds as typed after --fail-if: 'rmse/joint>0.02', 'faults>0', 'fault/encoder_offset/*>0.05', 'delay/*>0.05'."""

import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase

from ..errors import BoundError, UsageError
from ..io.toml_keys import nearest
from ..score_names import FIGURES, renamed, split
from ..types import Score

COMPARE: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}
MOST = 12
"""Names that a refusal lists."""


@dataclass(frozen=True)
class Bound:
    """Fails when a figure that `name` matches, * and ? as in file names, compares so with `limit`."""

    name: str
    sign: str
    limit: float


def parse(text: str) -> Bound:
    """A bound as typed; UsageError unless it is a name of today, a sign and a number."""
    found = re.fullmatch(r"\s*([^\s<>=]+)\s*(>=|<=|>|<)\s*([-+0-9.eE]+)\s*", text)
    if found and (now := renamed(found[1])):
        raise UsageError(f"--fail-if {text!r}: {found[1]} is called {now} now; type {now}{found[2]}{found[3]}")
    if found and not _possible(found[1]):
        near = nearest(found[1].partition("*")[0] or found[1], list(FIGURES))
        raise UsageError(f"--fail-if {text!r}: no score is called {found[1]}; did you mean {near}? see docs/metrics.md")
    try:
        return Bound(found[1], found[2], float(found[3])) if found else _refuse(text)
    except ValueError:
        return _refuse(text)


def _possible(name: str) -> bool:
    """Whether some score may have this name, in which * and ? may stand for any part of it."""
    fixed = re.split(r"[*?\[]", name, maxsplit=1)[0]
    if fixed == name:
        return split(name)[0] in FIGURES
    return any(figure.startswith(fixed) or fixed.startswith(f"{figure}/") for figure in FIGURES)


def _refuse(text: str) -> Bound:
    raise UsageError(
        f"--fail-if {text!r}: not a bound; type a score, a sign and a number, e.g. 'rmse/joint>0.02' or 'faults>0'"
    )


def check(figures: Mapping[str, Sequence[Score]], bounds: Sequence[Bound]) -> None:
    """BoundError naming each broken bound; UsageError when a log has no such figure. A NaN breaks its bound."""
    broken = [text for path, found in figures.items() for bound in bounds for text in _broken(path, found, bound)]
    if broken:
        raise BoundError("; ".join(broken))


def measured(figures: Sequence[Score], bounds: Sequence[Bound]) -> list[Bound]:
    """The bounds that name any of the figures."""
    names = [figure.name for figure in figures]
    return [
        bound
        for bound in bounds
        if bound.name in names or any(fnmatchcase(name, bound.name) for name in names)
    ]


def _broken(path: str, figures: Sequence[Score], bound: Bound) -> Iterator[str]:
    values = {figure.name: figure.value for figure in figures}
    plain = [bound.name] if bound.name in values else [name for name in values if fnmatchcase(name, bound.name)]
    if not plain:
        raise UsageError(f"{path}: no score {bound.name!r} to bound; {_near(bound.name, values)}")
    for name in plain:
        value = values[name]
        if value != value or COMPARE[bound.sign](value, bound.limit):
            yield f"{path}: {name} is {value:.6g}, bound broken: {bound.sign} {bound.limit:g}"


def _near(name: str, values: Mapping[str, float]) -> str:
    """Names like the one typed, else the kinds of names there are."""
    parts = name.strip("*").split("/")
    near = get_close_matches(name, values, MOST, 0.6) or [one for one in values if parts[-1] and parts[-1] in one]
    if len(values) <= MOST:
        near = sorted(values)
    if near:
        return f"possible: {', '.join(near[:MOST])}"
    kinds = {f"{one.split('/')[0]}/..." if "/" in one else one for one in values}
    return f"possible: {', '.join(sorted(kinds))}"
