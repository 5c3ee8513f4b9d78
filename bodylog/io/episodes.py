"""Names of episodes: DATASET#N is episode N of a
dataset (a folder or a file), DATASET#A-B are several.
"""

import re
from pathlib import Path

from ..errors import UsageError

MOST = 100_000
"""The most episodes that a range may name."""
_NAME = re.compile(r"(?P<base>.*)#(?P<first>\d{1,9})(?:-(?P<last>\d{1,9}))?", re.DOTALL)


def split_episode_name(path: Path) -> tuple[Path, int | None]:
    """The dataset and episode number in a name; None if it names no single episode."""
    base, first, last = _parse_episode_name(path)
    return (base, first) if first is not None and first == last else (path, None)


def dataset_path(path: Path) -> Path:
    """The path on disk: an episode's dataset, else the path itself."""
    return split_episode_name(path)[0]


def name_episode(dataset: Path, number: int) -> Path:
    """The name of one episode."""
    return Path(f"{dataset}#{number}")


def expand_episode_range(path: Path) -> tuple[Path, ...]:
    """The episodes of a range DATASET#A-B, in order; any other name unchanged."""
    dataset, first, last = _parse_episode_name(path)
    if first is None or last is None or first == last:
        return (path,)
    if not 0 <= last - first < MOST:
        raise UsageError(
            f"{path}: a range runs from the smaller number, over at most {MOST} episodes, e.g. #0-9"
        )
    return tuple(name_episode(dataset, number) for number in range(first, last + 1))


def _parse_episode_name(path: Path) -> tuple[Path, int | None, int | None]:
    """Dataset, first and last episode; (path, None,
    None) for the name of a file, or without a dataset.
    """
    match = _NAME.fullmatch(path.name)
    if match is None or path.exists():
        return path, None, None
    dataset = path.with_name(match["base"]) if match["base"] else path.parent
    if not dataset.exists():
        return path, None, None
    first = int(match["first"])
    return dataset, first, first if match["last"] is None else int(match["last"])
