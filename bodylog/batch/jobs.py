"""Which logs a batch is about, and what each is called."""

import glob
import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import LogError, UsageError
from ..settings import Settings

SUFFIXES = (".bag", ".bag.active", ".mcap", ".mcap.zst", ".db3", ".db3.zstd")


@dataclass(frozen=True)
class Job:
    """One log to estimate, score and report on, the folder for what comes of it, and whether an earlier run counts."""

    name: str
    log: Path
    folder: Path
    body: Path
    settings: Settings
    bounds: tuple[str, ...]
    resume: bool


def named(logs: Sequence[str], shard: tuple[int, int]) -> dict[str, Path]:
    """This shard's logs by name, in path order; LogError when there are none, UsageError when the shard is unsound."""
    index, count = shard
    if not 1 <= index <= count:
        raise UsageError(f"--shard {index}/{count}: the first number runs from 1 to the second")
    found = sorted({path for given in logs for path in find(given)})
    if not found:
        raise LogError(f"{', '.join(logs)}: no log in there; logs end in {', '.join(SUFFIXES)}")
    names = _names(found)
    return {names[path]: path for path in found[index - 1 :: count]}


def find(given: str) -> Iterator[Path]:
    """Logs behind a file, a folder (searched to the bottom) or a pattern; LogError when there is none."""
    paths = [Path(given)] if Path(given).exists() else [Path(m) for m in sorted(glob.glob(given, recursive=True))]
    if not paths:
        raise LogError(f"{given}: no such file, folder or pattern; type: ls {given}")
    for path in paths:
        yield from _inside(path) if path.is_dir() else [path]


def _inside(folder: Path) -> Iterator[Path]:
    if is_rosbag2(folder):
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.name.startswith("."):
            yield from _inside(path)
        elif path.name.endswith(SUFFIXES):
            yield path


def is_rosbag2(folder: Path) -> bool:
    """Whether a folder is one recorded log rather than a folder of logs."""
    return (folder / "metadata.yaml").is_file() or any(folder.glob("*.db3"))


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """A folder name per log: its file name made safe, told apart by a digest of the path where two are alike."""
    plain = {path: re.sub(r"[^A-Za-z0-9._-]", "_", path.name).lstrip(".") or "log" for path in paths}
    taken = list(plain.values())
    return {path: name if taken.count(name) == 1 else f"{name}-{_digest(path)}" for path, name in plain.items()}


def _digest(path: Path) -> str:
    return hashlib.sha256(str(path).encode()).hexdigest()[:8]
