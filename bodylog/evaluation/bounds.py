"""Bounds as typed after --fail-if: 'rmse/joint>0.02',
'faults>0', 'fault/encoder_offset/*>0.05', 'delay/*>0.05'.
"""

import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase

from ..errors import BoundError, UsageError
from ..io.toml_keys import find_nearest_name
from ..score_names import FIGURES, split_score_name
from ..types import Score

COMPARE: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}
MAX_LISTED_NAMES = 12
"""Names that a refusal lists."""


@dataclass(frozen=True)
class ScoreBound:
    """Fails if a figure that `name` matches, * and ? as in file names, compares so with `limit`."""

    name: str
    sign: str
    limit: float


def parse_bound(text: str) -> ScoreBound:
    """A bound as typed; UsageError unless it is a name, a sign and a number."""
    found = re.fullmatch(r"\s*([^\s<>=]+)\s*(>=|<=|>|<)\s*([-+0-9.eE]+)\s*", text)
    if found and not _may_name_score(found[1]):
        near = _nearest_figure(found[1].partition("*")[0] or found[1])
        raise UsageError(
            f"--fail-if {text!r}: no score is called {found[1]}; did you mean {near}? see "
            "docs/metrics.md"
        )
    try:
        return ScoreBound(found[1], found[2], float(found[3])) if found else _refuse_bound(text)
    except ValueError:
        return _refuse_bound(text)


def _nearest_figure(name: str) -> str:
    """The figure most like a name, or the first of the kind most like it."""
    kinds = [figure.partition("/")[0] for figure in FIGURES]
    near = find_nearest_name(name, [*FIGURES, *kinds])
    return next(figure for figure in FIGURES if figure == near or figure.startswith(f"{near}/"))


def _may_name_score(name: str) -> bool:
    """Whether some score may have this name, in which * and ? may stand for any part of it."""
    fixed = re.split(r"[*?\[]", name, maxsplit=1)[0]
    if fixed == name:
        return split_score_name(name)[0] in FIGURES
    return any(figure.startswith(fixed) or fixed.startswith(f"{figure}/") for figure in FIGURES)


def _refuse_bound(text: str) -> ScoreBound:
    raise UsageError(
        f"--fail-if {text!r}: not a bound; type a score, a sign and a number, e.g. "
        "'rmse/joint>0.02' or 'faults>0'"
    )


def check_bounds(figures: Mapping[str, Sequence[Score]], bounds: Sequence[ScoreBound]) -> None:
    """BoundError naming each broken bound; UsageError
    when a log has no such figure. A NaN breaks its bound.
    """
    broken = [
        text
        for path, found in figures.items()
        for bound in bounds
        for text in _list_broken_bounds(path, found, bound)
    ]
    if broken:
        raise BoundError("; ".join(broken))


def select_measured_bounds(
    figures: Sequence[Score], bounds: Sequence[ScoreBound]
) -> list[ScoreBound]:
    """The bounds that name any of the figures."""
    names = [figure.name for figure in figures]
    return [
        bound
        for bound in bounds
        if bound.name in names or any(fnmatchcase(name, bound.name) for name in names)
    ]


def _list_broken_bounds(path: str, figures: Sequence[Score], bound: ScoreBound) -> Iterator[str]:
    values = {figure.name: figure.value for figure in figures}
    plain = (
        [bound.name]
        if bound.name in values
        else [name for name in values if fnmatchcase(name, bound.name)]
    )
    if not plain:
        raise UsageError(
            f"{path}: no score {bound.name!r} to bound; {_suggest_score_names(bound.name, values)}"
        )
    for name in plain:
        value = values[name]
        if value != value or COMPARE[bound.sign](value, bound.limit):
            yield f"{path}: {name} is {value:.6g}, bound broken: {bound.sign} {bound.limit:g}"


def _suggest_score_names(name: str, values: Mapping[str, float]) -> str:
    """Names like the one typed, else the kinds of names there are."""
    parts = name.strip("*").split("/")
    near = get_close_matches(name, values, MAX_LISTED_NAMES, 0.6) or [
        one for one in values if parts[-1] and parts[-1] in one
    ]
    if len(values) <= MAX_LISTED_NAMES:
        near = sorted(values)
    if near:
        return f"possible: {', '.join(near[:MAX_LISTED_NAMES])}"
    kinds = {f"{one.split('/')[0]}/..." if "/" in one else one for one in values}
    return f"possible: {', '.join(sorted(kinds))}"
