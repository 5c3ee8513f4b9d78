"""Scores compared with those of an earlier batch: an
error that grew beyond the tolerance breaks a bound.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import BoundError, InputError, UsageError
from ..io import atomic_files
from ..io.values import read_json
from ..score_names import split_score_name
from ..types import Score

_MOST_BYTES = 256 << 20
ERRORS = ("rmse/joint",)
"""Figures where more is worse."""


def parse_tolerance(text: str) -> float:
    """A share from what was typed, "5%" or "0.05"; UsageError
    if it is neither, or a number that may be either.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(%?)\s*", text)
    if not found:
        raise UsageError(f"--tolerance {text!r}: it must be a share, e.g. 5%")
    if not found[2] and float(found[1]) > 1:
        raise UsageError(
            f"--tolerance {text!r}: a share above 1 without a %; type --tolerance {text.strip()}%"
        )
    return float(found[1]) / (100 if found[2] else 1)


def load_baseline(path: Path) -> dict[str, dict[str, float | None]]:
    """Scores by log name from a results.jsonl; InputError if it is not one."""
    try:
        rows = [
            read_json(line)
            for line in atomic_files.read_limited_text(path, _MOST_BYTES).splitlines()
        ]
        found = {row["name"]: dict(row["scores"]) for row in rows}
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise InputError(
            f"{path}: not a results.jsonl of a batch ({err}); type: bodylog batch LOG... -o DIR"
        ) from err
    return found


def check_against_baseline(
    found: Mapping[str, Sequence[Score]],
    before: Mapping[str, Mapping[str, float | None]],
    share: float,
) -> None:
    """BoundError naming every error that grew by more than
    `share`; UsageError when a log is not in the baseline.
    """
    worse = [
        text
        for name, scores in found.items()
        for text in _list_grown_errors(name, scores, before, share)
    ]
    if worse:
        raise BoundError("; ".join(worse))


def _list_grown_errors(
    name: str,
    scores: Sequence[Score],
    before: Mapping[str, Mapping[str, float | None]],
    share: float,
) -> list[str]:
    if name not in before:
        raise UsageError(
            f"{name}: not in the baseline, which has {', '.join(sorted(before)) or 'no logs'}"
        )
    grown = []
    for score in scores:
        old = before[name].get(score.name)
        if (
            split_score_name(score.name)[0] in ERRORS
            and old is not None
            and not score.value <= old * (1 + share)
        ):
            grown.append(
                f"{name}: {score.name} was {old:.6g}, is {score.value:.6g}, more than "
                f"{share:.3%} worse"
            )
    return grown
