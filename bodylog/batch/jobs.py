"""Which logs a batch is about, paths or URLs, and what each is called."""

import glob
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import stores
from ..errors import LogError, UsageError
from ..settings import Settings
from . import folders

Row = dict[str, Any]
"""What became of one log, as plain values: a line of results.jsonl."""

SUFFIXES = (".bag", ".bag.active", ".mcap", ".mcap.zst", ".db3", ".db3.zstd")


@dataclass(frozen=True)
class Job:
    """One log to estimate, score and report on, the folder for what comes of it, and whether an earlier run counts.

    `how` is a digest of all that the result depends on but the log.
    """

    name: str
    log: str
    folder: Path
    body: Path
    settings: Settings
    bounds: tuple[str, ...]
    resume: bool
    how: str = ""


def named(logs: Sequence[str]) -> dict[str, str]:
    """The logs by name, in path order; LogError when there are none."""
    found = sorted({log for given in logs for log in find(given)})
    if not found:
        raise LogError(f"{', '.join(logs)}: no log in there; logs end in {', '.join(SUFFIXES)}")
    names = folders.named({log: _file_name(log) for log in found})
    return {names[log]: log for log in found}


def share(names: Iterable[str], shard: tuple[int, int]) -> tuple[str, ...]:
    """The names that are this shard's; UsageError when the shard is unsound."""
    index, count = shard
    if not 1 <= index <= count:
        raise UsageError(f"--shard {index}/{count}: the first number runs from 1 to the second")
    return tuple(names)[index - 1 :: count]


def find(given: str) -> Iterator[str]:
    """Logs behind a file, a folder (searched to the bottom), a pattern or a URL; LogError when there is none.

    What a batch left is found only where it is named.
    """
    if stores.is_url(given):
        yield from stores.behind(given, SUFFIXES)
        return
    matches = (Path(match) for match in sorted(glob.glob(given, recursive=True)))
    paths = [Path(given)] if Path(given).exists() else [m for m in matches if not folders.is_result(m.parent)]
    if not paths:
        raise LogError(f"{given}: no such file, folder or pattern; type: ls {given}")
    for path in paths:
        yield from map(str, _inside(path, set()) if path.is_dir() else [path])


def _inside(folder: Path, seen: set[Path]) -> Iterator[Path]:
    """The logs in a folder; `seen` are folders that were looked into, which links may lead back to."""
    if folder.resolve() in seen or folders.is_result(folder):
        return
    seen.add(folder.resolve())
    if is_rosbag2(folder):
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.name.startswith("."):
            yield from _inside(path, seen)
        elif path.name.endswith(SUFFIXES):
            yield path


def is_rosbag2(folder: Path) -> bool:
    """Whether a folder is one recorded log rather than a folder of logs."""
    return (folder / "metadata.yaml").is_file() or any(folder.glob("*.db3"))


def _file_name(log: str) -> str:
    return stores.name_of(log) if stores.is_url(log) else Path(log).name
