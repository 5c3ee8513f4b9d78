"""Results that an earlier run left: valid if inputs,
settings and version are the same and outputs are unchanged.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import pipeline
from ..errors import BodylogError, LogError, ModelError, UsageError
from ..io import episodes, remote
from ..io.atomic_files import hash_files, replace_atomically
from ..io.atomic_files import read_limited_text as read_text
from ..io.values import read_json
from ..logs.formats import hash_log
from ..score_names import FIGURES, split_score_name
from ..settings import Settings, settings_as_values
from ..version import __version__
from .folders import RESULT, ROW, mark_folder
from .jobs import ESTIMATE, KEYS, Job, Row

_LONGEST = 64 << 20
"""Bytes of a row."""
HOW = "how"
"""Key of row.json: a digest of everything but the log that the row depends on."""
ODD = "backslashreplace"
"""Encoding of bytes in file names that are not UTF-8; JSON preserves it."""


def job_key(job: Job) -> str:
    """Digest of what a log's outputs depend on: log (a
    URL: its identity), body, settings, bounds, version.
    """
    wait_s = job.settings.input.max_wait_s
    log = (
        remote.remote_identity(job.log, wait_s)
        if remote.is_url(job.log)
        else hash_log(Path(job.log))
    )
    return _digest_parts([log, *_list_conditions(job.body, job.settings, job.bounds, job.task)])


def settings_digest(
    body: Path | None, settings: Settings, bounds: Sequence[str], task: str = ESTIMATE
) -> str:
    """Digest of what all logs' outputs depend on: body, settings, bounds, version, task."""
    return _digest_parts(_list_conditions(body, settings, bounds, task))


def _list_conditions(
    body: Path | None, settings: Settings, bounds: Sequence[str], task: str
) -> list[Any]:
    model = None if body is None else hash_files(body)
    # results of earlier versions, which knew one task, stay valid
    tasks = [] if task == ESTIMATE else [task]
    return [model, settings_as_values(settings), list(bounds), __version__, *tasks]


def write_row(job: Job, row: Row) -> Row:
    """Write a row beside its outputs; returns the row
    as `read_valid_row` and `read_finished_row` read it.
    """
    text = json.dumps({**row, HOW: job.how}, sort_keys=True, ensure_ascii=False, allow_nan=False)
    with replace_atomically(job.folder / ROW) as beside:
        beside.write_text(text, encoding="utf-8", errors=ODD)
    return _row_without_digest(json.loads(text))


def read_valid_row(job: Job) -> Row | None:
    """The row that another shard left with the same
    body, settings, bounds and version; None otherwise.
    """
    row = _read_row(job.folder / ROW)
    return (
        _row_without_digest(row)
        if row is not None and row.get(HOW) == job.how and _is_current(row)
        else None
    )


def read_finished_row(job: Job) -> Row | None:
    """The row of an earlier run, if its work is the
    same and its outputs are unchanged; None otherwise.
    """
    row = _read_row(job.folder / ROW)
    if row is None or not _is_current(row) or row["key"] is None or row["key"] != _key_or_none(job):
        return None
    whole = all(_has_digest(job.folder / name, digest) for name, digest in row["outputs"].items())
    if not whole or not _has_declared_messages(job, row):
        return None
    if row.get(HOW) == job.how:
        return _row_without_digest(row)
    mark_folder(job.folder, RESULT)  # by an earlier version
    return write_row(job, row)


def _is_current(row: Row) -> bool:
    """Whether a row has the keys of this version's rows, and its scores their names."""
    if not row.keys() >= KEYS or not all(
        isinstance(row[name], kind) for name, kind in _KINDS.items()
    ):
        return False
    texts = (*row["outputs"].values(), *row["headline"].values())
    written = all(isinstance(text, str) for text in texts)
    numbers = all(isinstance(value, float | int | None) for value in row["scores"].values())
    return (
        written and numbers and all(split_score_name(name)[0] in FIGURES for name in row["scores"])
    )


_KINDS: Mapping[str, Any] = {
    "name": str,
    "log": str,
    "key": str | None,
    "status": str,
    "exit_code": int,
    "error": str | None,
    "messages": int | None,
    "outputs": dict,
    "scores": dict,
    "used": dict,
    "verdict": list,
    "headline": dict,
    "faults": list,
    "health": dict,
    "findings": list,
}
"""The kinds of a row's values; a file between two runs may hold anything."""


def _row_without_digest(row: Row) -> Row:
    return {name: value for name, value in row.items() if name != HOW}


def _key_or_none(job: Job) -> str | None:
    try:
        return job_key(job)
    except (OSError, BodylogError):
        return None


def _read_row(path: Path) -> Row | None:
    try:
        row = read_json(read_text(path, _LONGEST))
    except (OSError, ValueError):
        return None
    return row if isinstance(row, dict) and "outputs" in row else None


def _has_digest(path: Path, digest: str) -> bool:
    return path.is_file() and hash_files(path) == digest


def _has_declared_messages(job: Job, row: Row) -> bool:
    """Whether the annotated log has as many messages as its row declares."""
    if "annotated.mcap" not in row["outputs"]:
        return True
    try:
        return bool(
            pipeline.count_declared_messages(job.folder / "annotated.mcap") == row["messages"]
        )
    except BodylogError:
        return False


def learn_body_once(train: Sequence[Path], body: Path, settings: Settings) -> Path:
    """Learn the body model from `train`, unless the
    existing one is from the same logs and settings.
    """
    for log in train:
        if not episodes.dataset_path(log).exists():
            raise LogError(f"{log}: there is no such file or folder; check the name")
    mark_file = _mark_of(body)
    wanted = _digest_parts(
        [[hash_log(log) for log in train], settings_as_values(settings), __version__]
    )
    known = _read_mark(mark_file)
    if not (_is_loadable_body(body) and known == [wanted, hash_files(body)]):
        _leave_mark(mark_file, [wanted, None])
        pipeline.fit(train, body, settings)
        _leave_mark(mark_file, [wanted, hash_files(body)])
    return body


def check_replaceable(body: Path) -> None:
    """UsageError if a body model or a mark beside it exists that is not from a batch.

    The mark holds the body's digest, or None while the body is being learned.
    """
    mark_file = _mark_of(body)
    known = _read_mark(mark_file)
    ours = isinstance(known, list) and len(known) == 2
    if mark_file.exists() and not ours:
        raise UsageError(
            f"{mark_file}: no batch wrote this file, and --train would replace it; type another -o"
        )
    if body.exists() and not (ours and body.is_file() and known[1] in (None, hash_files(body))):
        raise UsageError(
            f"{body}: no batch learned this body, and --train would replace it; type another -o"
        )


def _mark_of(body: Path) -> Path:
    return body.with_name("body.json")


def _leave_mark(path: Path, value: Any) -> None:
    with replace_atomically(path) as beside:
        beside.write_text(json.dumps(value), encoding="utf-8")


def _is_loadable_body(body: Path) -> bool:
    from ..body import storage

    try:
        storage.load_body(body)
    except ModelError:
        return False
    return True


def _read_mark(path: Path) -> Any:
    try:
        return read_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _digest_parts(parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
