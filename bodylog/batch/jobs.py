"""The logs of a batch, paths or URLs, and their names."""

import glob
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import BodylogError, LogError, UsageError
from ..io import episodes, remote
from ..io.outputs import Key, path_identity
from ..settings import Settings
from . import folders

Row = dict[str, Any]
"""The results of one log as plain values: a line of results.jsonl."""
KEYS = frozenset(
    (
        "name",
        "log",
        "key",
        "status",
        "exit_code",
        "error",
        "messages",
        "outputs",
        "scores",
        "used",
        "verdict",
        "headline",
        "faults",
        "health",
        "findings",
    )
)
"""The keys of a row."""

ESTIMATE = "estimate"
EXAMINE = "examine"
"""The tasks of a batch: estimate and score each log, or examine it beside its siblings."""
MOST = 100_000
"""Most names that a pattern may match, and most folders that are searched."""
_MOST_FOLDERS = 3
"""Most folders whose names tell files of one name apart."""
SUFFIXES = (
    ".bag",
    ".bag.active",
    ".bag.zst",
    ".bag.lz4",
    ".mcap",
    ".mcap.zst",
    ".mcap.lz4",
    ".db3",
    ".db3.zstd",
    ".hdf5",
    ".h5",
)


@dataclass(frozen=True)
class Job:
    """One log, its results' folder, and whether to keep an earlier run's results.

    `task` is what is done with the log, a name of work.TASKS. `how` is a digest of everything but
    the log that the results depend on.
    """

    name: str
    log: str
    folder: Path
    body: Path | None
    settings: Settings
    bounds: tuple[str, ...]
    resume: bool
    how: str = ""
    task: str = ESTIMATE


def name_logs(logs: Sequence[str], wait_s: float = remote.WAIT_S) -> dict[str, str]:
    """The logs by name, in the order of their paths, numbers in these by size; LogError if there
    is no log, or no answer of a server within `wait_s`.
    """
    found = sorted({log for given in logs for log in find_logs(given, wait_s)}, key=_order_of_path)
    if not found:
        raise LogError(f"{', '.join(logs)}: no log in there; logs end in {', '.join(SUFFIXES)}")
    names = folders.name_folders(_name_by_files(found))
    return {names[log]: log for log in found}


def _name_by_files(logs: Sequence[str]) -> dict[str, str]:
    """The logs' file names, with the names of as many folders as tell files of one name apart."""
    names = {log: (remote.name_of(log) if remote.is_url(log) else Path(log).name) for log in logs}
    for depth in range(2, _MOST_FOLDERS + 2):
        counts = Counter(map(folders.fold_case, names.values()))
        for log, name in names.items():
            if counts[folders.fold_case(name)] > 1 and not remote.is_url(log):
                names[log] = "_".join(Path(log).parts[-depth:])
    return names


def _order_of_path(path: str) -> tuple[list[str | int], str]:
    """What paths are sorted by: episode 2 is before episode 10, as they were recorded."""
    parts = re.split(r"(\d+)", path)
    return [int(part) if number % 2 else part for number, part in enumerate(parts)], path


def select_shard(names: Iterable[str], shard: tuple[int, int]) -> tuple[str, ...]:
    """The names of this shard (I, N): every N-th,
    from the I-th; UsageError for an impossible shard.
    """
    index, count = shard
    if not 1 <= index <= count:
        raise UsageError(f"--shard {index}/{count}: the first number runs from 1 to the second")
    return tuple(names)[index - 1 :: count]


def find_logs(given: str, wait_s: float = remote.WAIT_S) -> Iterator[str]:
    """The logs of a file, a folder (searched recursively),
    a pattern or a URL; LogError if there is no log.

    Results of a batch are skipped unless they are named.
    """
    if remote.is_url(given):
        yield from remote.expand_url(given, SUFFIXES, wait_s)
        return
    if (
        not Path(given).exists()
        and (some := episodes.expand_episode_range(Path(given)))
        and episodes.split_episode_name(some[0])[1] is not None
    ):
        yield from map(str, some)
        return
    paths = [Path(given)] if Path(given).exists() else _match_pattern(given)
    if not paths:
        raise LogError(f"{given}: no such file, folder or pattern; type: ls {given}")
    for path in paths:
        yield from map(str, _find_logs_in_folder(path) if path.is_dir() else _list_episodes(path))


def _list_episodes(path: Path) -> list[Path]:
    """The episodes of a dataset that has several; otherwise
    the path, also of a dataset that cannot be read.
    """
    from ..logs.datasets import kinds

    try:
        numbers = kinds.episode_numbers(path)
    except (BodylogError, OSError):
        return [path]
    return [episodes.name_episode(path, number) for number in numbers] or [path]


def _match_pattern(pattern: str) -> list[Path]:
    """The paths that match a pattern, without results of batches; UsageError for too many."""
    if re.search(r"[*?\[].*/\.\.(/|$)", pattern):
        raise UsageError(
            f"{pattern}: a pattern goes back (..) after a wildcard; name the folders to "
            "search instead"
        )
    found = glob.iglob(re.sub(r"(\*\*/)+", "**/", pattern), recursive=True)
    try:
        matches = list(itertools.islice(found, MOST + 1))
    except RecursionError:
        raise UsageError(
            f"{pattern}: folders are too deep for a pattern; name a folder to search instead"
        ) from None
    if len(matches) > MOST:
        raise UsageError(f"{pattern}: more than {MOST} names fit; name folders nearer to the logs")
    return [path for path in map(Path, sorted(matches)) if not folders.is_result(path.parent)]


def _find_logs_in_folder(folder: Path) -> Iterator[Path]:
    """The logs in a folder, in path order, each folder once
    despite links; UsageError if there are too many folders.
    """
    from ..logs.datasets import kinds

    seen = set[Key | None]((None,))
    left = [folder]
    while left:
        path = left.pop()
        if not path.is_dir():
            yield from _list_episodes(path)
            continue
        if (found := path_identity(path)) in seen or folders.is_result(path):
            continue
        seen.add(found)
        if len(seen) > MOST:
            raise UsageError(
                f"{folder}: more than {MOST} folders are in it; name folders nearer to the logs"
            )
        if is_rosbag2(path) or kinds.is_episode_dataset(path):
            yield from _list_episodes(path)
            continue
        names = sorted(path.iterdir(), reverse=True)
        left += [
            one for one in names if (one.name[0] != "." if one.is_dir() else _is_log(one.name))
        ]


def is_rosbag2(folder: Path) -> bool:
    """Whether a folder is a rosbag2 log rather than a folder
    of logs: described as one, or with databases alone.
    """
    if (folder / "metadata.yaml").is_file():
        return True
    names = [
        path.name.lower() for path in folder.iterdir() if _is_log(path.name) and path.name[0] != "."
    ]
    return any(name.endswith(".db3") for name in names) and all(".db3" in name for name in names)


def _is_log(name: str) -> bool:
    """Whether a file's name is that of a log, in small letters or capitals."""
    return name.lower().endswith(SUFFIXES)
