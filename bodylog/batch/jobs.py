"""Which logs a batch is about, paths or URLs, and what each is called."""

import fcntl
import glob
import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import stores
from ..errors import LogError, UsageError
from ..settings import Settings

LOCK = ".lock"
"""In a folder of what came of a log: nothing there is a log to begin with."""

Row = dict[str, Any]
"""What became of one log, as plain values: a line of results.jsonl."""

SUFFIXES = (".bag", ".bag.active", ".mcap", ".mcap.zst", ".db3", ".db3.zstd")


@dataclass(frozen=True)
class Job:
    """One log to estimate, score and report on, the folder for what comes of it, and whether an earlier run counts."""

    name: str
    log: str
    folder: Path
    body: Path
    settings: Settings
    bounds: tuple[str, ...]
    resume: bool


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Wait until nobody else is at what goes into a folder, and keep others waiting meanwhile."""
    with (folder / LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def named(logs: Sequence[str], shard: tuple[int, int]) -> dict[str, str]:
    """This shard's logs by name, in path order; LogError when there are none, UsageError when the shard is unsound."""
    index, count = shard
    if not 1 <= index <= count:
        raise UsageError(f"--shard {index}/{count}: the first number runs from 1 to the second")
    found = sorted({log for given in logs for log in find(given)})
    if not found:
        raise LogError(f"{', '.join(logs)}: no log in there; logs end in {', '.join(SUFFIXES)}")
    names = _names(found)
    return {names[log]: log for log in found[index - 1 :: count]}


def find(given: str) -> Iterator[str]:
    """Logs behind a file, a folder (searched to the bottom), a pattern or a URL; LogError when there is none.

    What a batch left is found only where it is named.
    """
    if stores.is_url(given):
        yield from stores.behind(given, SUFFIXES)
        return
    matches = (Path(match) for match in sorted(glob.glob(given, recursive=True)))
    paths = [Path(given)] if Path(given).exists() else [m for m in matches if not (m.parent / LOCK).is_file()]
    if not paths:
        raise LogError(f"{given}: no such file, folder or pattern; type: ls {given}")
    for path in paths:
        yield from map(str, _inside(path, set()) if path.is_dir() else [path])


def _inside(folder: Path, seen: set[Path]) -> Iterator[Path]:
    """The logs in a folder; `seen` are folders that were looked into, which links may lead back to."""
    if (folder / LOCK).is_file() or folder.resolve() in seen:
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


def _names(logs: Sequence[str]) -> dict[str, str]:
    """A folder name per log: its file name made safe, told apart by a digest of where it is when two are alike."""
    plain = {log: re.sub(r"[^A-Za-z0-9._-]", "_", _file_name(log)).lstrip(".") or "log" for log in logs}
    taken = Counter(plain.values())
    return {log: name if taken[name] == 1 else f"{name}-{_digest(log)}" for log, name in plain.items()}


def _file_name(log: str) -> str:
    return stores.name_of(log) if stores.is_url(log) else Path(log).name


def _digest(log: str) -> str:
    return hashlib.sha256(os.fsencode(log)).hexdigest()[:8]
