"""What need not be done again: rows whose inputs, settings and version are the same and whose outputs still hold."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .. import __version__, pipeline, stores
from ..errors import BodylogError, LogError, ModelError
from ..files import sha256
from ..settings import Settings, plain
from .jobs import Job, Row

ROW = "row.json"


def key(job: Job) -> str:
    """Digest of what the outputs depend on: log (what its store says of a URL), body, settings, bounds, version."""
    log = stores.identity(job.log) if stores.is_url(job.log) else sha256(Path(job.log))
    parts = [log, sha256(job.body), plain(job.settings), list(job.bounds), __version__]
    return _digest(parts)


def finished(job: Job) -> Row | None:
    """The row an earlier run left, if it is for the same work and each output is whole; None otherwise."""
    row = _read(job.folder / ROW)
    if row is None or row.get("key") != _key_or_none(job):
        return None
    outputs = row["outputs"]
    whole = all(_same(job.folder / name, digest) for name, digest in outputs.items())
    return row if whole and _counted(job, row) else None


def _key_or_none(job: Job) -> str | None:
    try:
        return key(job)
    except (OSError, BodylogError):
        return None


def _read(path: Path) -> Row | None:
    try:
        row = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return row if isinstance(row, dict) and "outputs" in row else None


def _same(path: Path, digest: str) -> bool:
    return path.is_file() and sha256(path) == digest


def _counted(job: Job, row: Row) -> bool:
    """Whether the annotated log, opened again, holds as many messages as its row says."""
    if "annotated.mcap" not in row["outputs"]:
        return True
    try:
        return bool(pipeline.count(job.folder / "annotated.mcap") == row["messages"])
    except BodylogError:
        return False


def learned(train: Sequence[Path], body: Path, settings: Settings) -> Path:
    """The body model learned from `train`; learned anew unless the one there comes from the same logs and settings."""
    for log in train:
        if not log.exists():
            raise LogError(f"{log}: there is no such file or folder; check the name")
    mark = body.with_name("body.json")
    wanted = _digest([[sha256(log) for log in train], plain(settings), __version__])
    if not (_loads(body) and (_read_mark(mark) == [wanted, sha256(body)])):
        pipeline.fit(train, body, settings)
        mark.write_text(json.dumps([wanted, sha256(body)]), encoding="utf-8")
    return body


def _loads(body: Path) -> bool:
    from ..body import model

    try:
        model.load(body)
    except ModelError:
        return False
    return True


def _read_mark(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _digest(parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
