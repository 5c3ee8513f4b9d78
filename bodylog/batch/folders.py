"""The folders a batch writes into: made and marked by it, so that nothing of anybody else's is ever replaced."""

import fcntl
import hashlib
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import OutputError, UsageError
from ..io.atomic_files import ensure_dir

BATCH = ".bodylog-batch"
"""Marks a folder that holds the results of a batch."""
RESULT = ".bodylog-result"
"""Marks a folder that holds what came of one log: nothing in it is a log to begin with."""
SUMMARIES = ("results.jsonl", "junit.xml", "summary.html")
BODY = ("body.npz", "body.json")
OUTPUTS = ("annotated.mcap", "report.html", "robot.toml")
ROW = "row.json"

_OLD_LOCK = ".lock"
_OLD = {_OLD_LOCK, ROW, *OUTPUTS}
_BEGIN = {
    "results.jsonl": b'{"error": ',
    "junit.xml": b"<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites name=\"bodylog\"",
    "summary.html": b'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>bodylog batch</title>',
}
"""How the files begin that earlier versions left in folders without a mark."""
_LONGEST = 200
TAKEN = frozenset((*SUMMARIES, *BODY))
"""Names in a batch's folder that no log's folder may have."""


def named(names: Mapping[str, str]) -> dict[str, str]:
    """A folder name per log, by log: its file name made safe, with a digest of where it is where two are alike.

    Alike are also names that differ in case or in how accents are spelled, for some disks take them for one.
    """
    plain = {log: re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip(".") or "log" for log, name in names.items()}
    taken = Counter([*map(folded, plain.values()), *TAKEN])
    for length in (8, 64):
        found = {log: f"{name[:_LONGEST]}-{_digest(log)[:length]}" for log, name in plain.items()}
        found |= {log: name for log, name in plain.items() if taken[folded(name)] == 1 and len(name) <= _LONGEST}
        if len(set(map(folded, found.values()))) == len(found):
            break
    return found


def folded(name: str) -> str:
    """A name as disks compare it that ignore case."""
    return unicodedata.normalize("NFC", name).casefold()


def _digest(log: str) -> str:
    return hashlib.sha256(log.encode(errors="surrogateescape")).hexdigest()


def check(folder: Path, results: Iterable[Path]) -> None:
    """UsageError when a batch into `folder`, with logs' folders `results`, would replace what no batch left there."""
    _no_file(folder)
    if not (folder / BATCH).is_file():
        for path in (folder / name for name in SUMMARIES):
            if path.exists() and not _left_by_a_batch(path):
                raise UsageError(f"{path}: no batch left this, and it would be replaced; give another folder with -o")
    for path in results:
        _no_file(path)
        if path.is_dir() and not is_result(path) and any(path.iterdir()):
            raise UsageError(f"{path}: no batch made this folder, and its results go there; give another one with -o")


def _no_file(folder: Path) -> None:
    if (folder.exists() or folder.is_symlink()) and not folder.is_dir():
        raise OutputError(f"{folder}: is in the place of a folder; give another one with -o")


def _left_by_a_batch(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        begin = stream.read(len(_BEGIN[path.name]))
    return begin in (b"", _BEGIN[path.name])


def is_result(folder: Path) -> bool:
    """Whether a batch made this folder for what came of a log; earlier versions marked it with a lock alone."""
    if (folder / RESULT).is_file():
        return True
    return (folder / _OLD_LOCK).is_file() and all(
        path.name in _OLD or re.fullmatch(r"\..*\.part", path.name) for path in folder.iterdir()
    )


def mark(folder: Path, name: str) -> Path:
    """`folder`, made where it is not there yet, and marked."""
    ensure_dir(folder)
    (folder / name).open("a").close()
    if name == RESULT:
        (folder / _OLD_LOCK).unlink(missing_ok=True)
    return folder


@contextmanager
def alone(folder: Path, name: str) -> Iterator[None]:
    """Wait until nobody else is at what goes into a marked folder, and keep others waiting meanwhile.

    Where files cannot be locked nobody waits: each file is written whole, and what was written is looked at again.
    """
    with (folder / name).open("a") as lock:
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield
