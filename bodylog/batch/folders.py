"""The folders of a batch: marked by it, so that it replaces only its own files."""

import hashlib
import json
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ..errors import OutputError, UsageError
from ..io import episodes, remote
from ..io.atomic_files import ensure_dir
from ..io.temporary import lock_handle
from ..io.values import read_json

BATCH = ".bodylog-batch"
"""Marks a folder that holds the results of a batch."""
RESULT = ".bodylog-result"
"""Marks a folder that holds the results of one log; its files are never taken as input logs."""
SUMMARIES = ("results.jsonl", "junit.xml", "summary.html")
DATASET = "dataset.json"
"""The row of a dataset as a whole."""
PAGE = "report.html"
"""The page about a dataset: of its episodes, and in a batch of estimates of each log."""
BODY = ("body.npz", "body.json")
OUTPUTS = ("annotated.mcap", PAGE, "robot.toml")
EVIDENCE = ("evidence.json",)
ROW = "row.json"

_OLD_LOCK = ".lock"
_OLD = {_OLD_LOCK, ROW, *OUTPUTS}
_BEGIN = {
    "results.jsonl": b'{"error": ',
    "junit.xml": b'<?xml version="1.0" encoding="UTF-8"?>\n<testsuites name="bodylog"',
    "summary.html": b'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>bodylog batch</title>',
}
"""First bytes of the files that earlier versions left in unmarked folders."""
_LONGEST = 200
WRITTEN = (*SUMMARIES, PAGE, DATASET)
"""Files that an examination of a dataset may write into its folder."""
TAKEN = frozenset((*SUMMARIES, *BODY, PAGE, DATASET))
"""Names in a batch's folder that no log's folder may have."""


def name_folders(names: Mapping[str, str]) -> dict[str, str]:
    """A folder name for each log: its file name made safe,
    with a digest of its path where two names are equal.

    Names that differ only in case or in the encoding of accents
    are equal: some file systems do not distinguish them.
    """
    plain = {
        log: re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip(".") or "log"
        for log, name in names.items()
    }
    taken = Counter([*map(fold_case, plain.values()), *TAKEN])
    for length in (8, 64):
        found = {
            log: f"{name[:_LONGEST]}-{_digest_log_path(log)[:length]}"
            for log, name in plain.items()
        }
        found |= {
            log: name
            for log, name in plain.items()
            if taken[fold_case(name)] == 1 and len(name) <= _LONGEST
        }
        if len(set(map(fold_case, found.values()))) == len(found):
            break
    return found


def fold_case(name: str) -> str:
    """A name as case-insensitive file systems compare it."""
    return unicodedata.normalize("NFC", name).casefold()


def _digest_log_path(log: str) -> str:
    return hashlib.sha256(log.encode(errors="surrogateescape")).hexdigest()


def check_batch_folder(
    folder: Path, results: Iterable[Path], written: Iterable[str] = SUMMARIES
) -> None:
    """UsageError if a batch into `folder`, with the logs' folders `results`, would replace files of
    others; `written` are the names of the files that it writes into `folder`."""
    _refuse_file(folder)
    if not (folder / BATCH).is_file():
        for path in (folder / name for name in written):
            if path.exists() and not _left_by_a_batch(path):
                raise UsageError(
                    f"{path}: no batch wrote this file, and it would be replaced; type another -o"
                )
    for path in results:
        _refuse_file(path)
        if path.is_dir() and not is_result(path) and any(path.iterdir()):
            raise UsageError(
                f"{path}: no batch made this folder, and a log's results go there; type another -o"
            )


def _refuse_file(folder: Path) -> None:
    if (folder.exists() or folder.is_symlink()) and not folder.is_dir():
        raise OutputError(f"{folder}: is not a folder; type another -o")


def _left_by_a_batch(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        begin = stream.read(len(_BEGIN.get(path.name, b"")))
    return path.name in _BEGIN and begin in (b"", _BEGIN[path.name])


def is_result(folder: Path) -> bool:
    """Whether a batch made this folder for a log's results;
    earlier versions marked it with a lock file only.
    """
    if (folder / RESULT).is_file():
        return True
    return (folder / _OLD_LOCK).is_file() and all(
        path.name in _OLD or re.fullmatch(r"\..*\.part", path.name) for path in folder.iterdir()
    )


def mark_folder(folder: Path, name: str) -> Path:
    """Create the folder unless it exists, and mark it."""
    ensure_dir(folder)
    (folder / name).open("a").close()
    if name == RESULT:
        (folder / _OLD_LOCK).unlink(missing_ok=True)
    return folder


def claim_folder(folder: Path, logs: Mapping[str, str]) -> None:
    """Note in a marked folder whose results it holds, {name:
    log}; UsageError where it holds those of other logs.

    Summaries name the logs of one batch, so that another batch's rows would vanish from them.
    """
    with lock_folder(folder, BATCH):
        others = [
            log for name, log in read_claimed_logs(folder).items() if _is_other(name, log, logs)
        ]
        if others:
            what = f"{len(others)} logs that this batch does not name, as {others[0]}"
            raise UsageError(
                f"{folder}: it holds the results of {what}; type another -o, or name all of them"
            )
        text = json.dumps(
            {name: _log_location(log) for name, log in sorted(logs.items())}, ensure_ascii=True
        )
        (folder / BATCH).write_text(text, encoding="ascii")


def read_claimed_logs(folder: Path) -> dict[str, str]:
    """The logs whose results a marked folder holds, by name; empty if no batch noted them."""
    try:
        found = read_json((folder / BATCH).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return {name: str(log) for name, log in found.items()} if isinstance(found, dict) else {}


def _is_other(name: str, log: str, logs: Mapping[str, str]) -> bool:
    """Whether a log of an earlier batch has no row in this one, though it is still there."""
    same = name in logs and _log_location(logs[name]) == log
    return not same and (remote.is_url(log) or episodes.dataset_path(Path(log)).exists())


def _log_location(log: str) -> str:
    return log if remote.is_url(log) else os.path.abspath(log)


def is_claimed_by_more(folder: Path, logs: Mapping[str, str]) -> bool:
    """Whether a batch of other logs as well has noted meanwhile that the folder is its own."""
    found = read_claimed_logs(folder)
    return bool(found) and found != {name: _log_location(log) for name, log in logs.items()}


@contextmanager
def lock_folder(folder: Path, name: str) -> Iterator[None]:
    """Hold the lock of a marked folder.

    On file systems without locks nobody waits: each file is
    written atomically, and results are read again afterwards.
    """
    with (folder / name).open("a") as lock:
        lock_handle(lock.fileno(), wait=True)
        yield
