"""A dataset's own files against its episodes: counts in info.json, and stored statistics."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BodylogError
from ..io import episodes, remote
from ..types import Array
from ..wording import list_in_words

MOST_ERROR = 0.02
"""Error of a stored statistic that is reported, over the feature's range: rounding has 1e-6."""


def dataset_findings(logs: Mapping[str, str], evidence: Mapping[str, Any]) -> Iterator[str]:
    """What is wrong with the datasets that the logs {row's name: log} are episodes of."""
    from ..logs.datasets import checks, kinds, lerobot_layout

    by_folder: dict[Path, dict[int, str]] = {}
    for name, log in logs.items():
        if not remote.is_url(log):
            folder, number = episodes.split_episode_name(Path(log))
            if number is not None and folder.is_dir() and kinds.is_episode_dataset(folder):
                by_folder.setdefault(folder, {})[number] = name
    for folder, names in by_folder.items():
        try:
            known = lerobot_layout.read_dataset_layout(folder)
            yield from checks.of_dataset(known)
            yield from _check_statistics(known, names, evidence)
        except BodylogError as problem:
            yield str(problem)


def _check_statistics(
    known: Any, names: Mapping[int, str], evidence: Mapping[str, Any]
) -> Iterator[str]:
    """Stored statistics that are missing, or do not match the numbers."""
    from ..logs.datasets.lerobot_layout import EPISODE_STATISTICS, STATISTICS, stored_statistics
    from ..logs.datasets.statistics import combine_statistics

    of_each = known.folder / EPISODE_STATISTICS
    if not of_each.is_file() and not (known.folder / STATISTICS).is_file():
        path = of_each if known.version.startswith("v2.1") else known.folder / STATISTICS
        yield f"{path}: there is no such file; is the dataset downloaded completely?"
        return
    each, whole = stored_statistics(known)
    if of_each.is_file() and (missing := sorted(set(names).difference(each))):
        yield f"{of_each}: no statistics of episode {list_in_words([*map(str, missing)])}"
    found = {
        number: evidence[name]["statistics"] for number, name in names.items() if name in evidence
    }
    wrong = [
        f"{feature} of episode {number}"
        for number, own in sorted(found.items())
        for feature in sorted(own)
        if _statistics_disagree(
            own[feature], _as_mapping(_as_mapping(each.get(number)).get(feature))
        )
    ]
    if wrong:
        yield f"{EPISODE_STATISTICS} does not match the data: {list_in_words(wrong)}"
    if not isinstance(whole, dict) or not found:
        return
    common = set.intersection(*(set(own) for own in found.values()))
    features = sorted(name for name in common if _has_one_width(name, found.values()))
    joined = combine_statistics([{name: own[name] for name in features} for own in found.values()])
    complete = len(found) == len(known.rows)
    stale = [
        name
        for name in features
        if _statistics_disagree(
            joined[name],
            _as_mapping(whole.get(name)),
            ("min", "max", "mean", "std") if complete else (),
        )
        or _leaves_stored_range(joined[name], _as_mapping(whole.get(name)))
    ]
    if stale:
        yield f"{STATISTICS} does not match the data: {list_in_words(stale)}"


def _has_one_width(feature: str, found: Iterable[Mapping[str, Any]]) -> bool:
    """Whether a feature has as many numbers in every episode; their readers name those that
    differ."""
    return len({len(own[feature]["mean"]) for own in found}) == 1


def _statistics_disagree(
    own: Mapping[str, Any],
    stored: Mapping[str, Any],
    figures: Sequence[str] = ("min", "max", "mean", "std"),
) -> bool:
    """Whether a stored statistic differs from its own by more than rounding."""
    pairs = [(own[name], stored[name]) for name in figures if name in stored]
    scale = _column_span(own)
    return any(_differs_beyond_rounding(mine, theirs, scale) for mine, theirs in pairs)


def _differs_beyond_rounding(mine: Any, theirs: Any, scale: Array) -> bool:
    numbers = _as_number_array(theirs)
    if numbers is None or numbers.shape != scale.shape:
        return True
    return bool((np.abs(np.asarray(mine, float) - numbers) > MOST_ERROR * scale).any())


def _leaves_stored_range(own: Mapping[str, Any], stored: Mapping[str, Any]) -> bool:
    """Whether the numbers leave the range that is stored for all episodes."""
    scale = MOST_ERROR * _column_span(own)
    low, high = (_as_number_array(stored.get(side)) for side in ("min", "max"))
    if low is None or high is None or low.shape != scale.shape or high.shape != scale.shape:
        return False
    return bool(
        (np.asarray(own["min"]) < low - scale).any()
        or (np.asarray(own["max"]) > high + scale).any()
    )


def _column_span(own: Mapping[str, Any]) -> Array:
    """Range of each column, and at least 1e-3 of its size."""
    low = np.asarray(own["min"], float)
    high = np.asarray(own["max"], float)
    return np.asarray(np.maximum(high - low, 1e-3 * np.maximum(np.abs(low), np.abs(high))) + 1e-9)


def _as_number_array(value: Any) -> Array | None:
    try:
        return np.atleast_1d(np.asarray(value, float)).reshape(-1)
    except (TypeError, ValueError):
        return None


def _as_mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}
