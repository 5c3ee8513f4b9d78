"""One log of a batch: estimate, score and report it, or examine it; and the row of its results."""

import json
import shutil
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import Any

from .. import pipeline, views
from ..config import settings_as_toml
from ..errors import BodylogError, BoundError, LogError
from ..evaluation import bounds
from ..io import remote
from ..io.atomic_files import FULL, hash_files, write_text_atomically
from ..io.temporary import PART, remove_stale
from ..runtime import sigbus
from ..types import Fault, Health
from . import folders, resume
from .folders import EVIDENCE, OUTPUTS
from .jobs import ESTIMATE, EXAMINE, Job, Row
from .resume import ODD

STATUS = {
    0: "passed",
    3: "passed, input lost",
    4: "bound broken",
    65: "unusable",
    73: "not writable",
    74: "not written",
    1: "bug",
}
"""The status of a row by its exit code, the worst last."""


def run_job(job: Job) -> Row:
    """Run one job and write its row beside its outputs; every failure becomes a row."""
    sigbus.install_sigbus_handler()
    folders.mark_folder(job.folder, folders.RESULT)
    # a worker of a killed batch may still be running this job
    with folders.lock_folder(job.folder, folders.RESULT), _on_one_core():
        earlier = resume.read_finished_row(job) if job.resume else None
        return earlier or _run_job_afresh(job)


@contextmanager
def _on_one_core() -> Iterator[None]:
    """Use one core per log, so that `--jobs` is the number of cores of a batch."""
    from ..perception.colours.colour_tracker import THREADS

    token = THREADS.set(1)
    try:
        yield
    finally:
        THREADS.reset(token)


def _run_job_afresh(job: Job) -> Row:
    remove_stale(job.folder, f".*{PART}")
    for stale in (job.folder / name for name in (*OUTPUTS, *EVIDENCE, folders.ROW)):
        shutil.rmtree(stale) if stale.is_dir() and not stale.is_symlink() else stale.unlink(
            missing_ok=True
        )
    return resume.write_row(job, _attempt_job(job))


def write_died_row(job: Job, why: str) -> Row:
    """Write the row of a job whose worker died."""
    folders.mark_folder(job.folder, folders.RESULT)
    remove_stale(job.folder, f".*{PART}")
    return resume.write_row(job, _build_row(job, None, 1, why))


def write_skipped_row(job: Job) -> Row:
    """Write the row of a job that did not run because the batch stopped early."""
    why = "the batch stopped before this log; type the same command with --resume"
    folders.mark_folder(job.folder, folders.RESULT)
    return resume.write_row(job, {**_build_row(job, None, 1, why), "status": "not run"})


def _attempt_job(job: Job) -> Row:
    key = None
    try:
        key = resume.job_key(job)
        before = sigbus.zeroed_pages()
        done = TASKS[job.task](job)
        if sigbus.zeroed_pages() > before:
            raise LogError(f"{job.log}: part of it could not be read; check the disk it is on")
        return _build_row(job, key, **done)
    except BodylogError as err:
        return _build_row(job, key, err.exit_code if err.exit_code != 2 else 65, str(err))
    except OSError as err:
        return _build_row(
            job, key, 74 if err.errno in FULL else 65, f"{job.log}: {err.strerror or err}"
        )
    except MemoryError as err:
        return _build_row(job, key, 65, f"{job.log}: there is not enough memory ({err})")
    except Exception:
        return _build_row(job, key, 1, traceback.format_exc())


def _estimate_job(job: Job) -> dict[str, Any]:
    """Keywords of `_build_row`; a broken bound is an exit code of the row."""
    annotated = job.folder / "annotated.mcap"
    with remote.local_copy(job.log, job.folder, job.settings.input.max_wait_s) as log:
        result = pipeline.estimate(log, job.body, annotated, job.settings)
        about = tuple(
            replace(one, text=one.text.replace(str(log), job.log)) for one in result.findings
        )
        result = replace(result, findings=about)
    views.write_report(annotated, job.folder / "report.html", job.settings)
    write_text_atomically(job.folder / "robot.toml", settings_as_toml(job.settings), ODD)
    lost = any(finding.severity == "lost" for finding in result.findings)
    code = 3 if lost else 0
    error = None
    try:
        bounds.check_bounds(
            {job.name: result.figures}, [bounds.parse_bound(text) for text in job.bounds]
        )
    except BoundError as err:
        code = err.exit_code
        error = str(err)
    return {
        "code": code,
        "error": error,
        "result": result,
        "messages": pipeline.count_declared_messages(annotated),
    }


def _examine_job(job: Job) -> dict[str, Any]:
    """Keywords of `_build_row`, for an episode examined beside
    its siblings; its evidence is left for their comparison."""
    from ..dataset import examination

    with remote.local_copy(job.log, job.folder, job.settings.input.max_wait_s) as log:
        result, evidence = examination.examine_episode(log, job.settings, job.log, job.body)
    text = json.dumps(evidence, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write_text_atomically(job.folder / EVIDENCE[0], text, ODD)
    lost = any(finding.severity == "lost" for finding in result.findings)
    code = 3 if lost else 0
    error = None
    known = [bounds.parse_bound(text) for text in job.bounds]
    try:
        bounds.check_bounds(
            {job.name: result.scores}, bounds.select_measured_bounds(result.scores, known)
        )
    except BoundError as err:
        code = err.exit_code
        error = str(err)
    return {"code": code, "error": error, "result": result}


TASKS: Mapping[str, Callable[[Job], dict[str, Any]]] = {
    ESTIMATE: _estimate_job,
    EXAMINE: _examine_job,
}
"""What a batch does with each log, by the name of the task."""
LEAVES: Mapping[str, tuple[str, ...]] = {ESTIMATE: OUTPUTS, EXAMINE: EVIDENCE}
"""The files that a task leaves beside the row of each log."""


def _build_row(
    job: Job,
    key: str | None,
    code: int,
    error: str | None,
    result: pipeline.Result | None = None,
    messages: int | None = None,
) -> Row:
    return {
        "name": job.name,
        "log": job.log,
        "key": key,
        "status": STATUS[code],
        "exit_code": code,
        "error": error,
        "messages": messages,
        "outputs": {name: hash_files(job.folder / name) for name in LEAVES[job.task] if result},
        "scores": {score.name: _finite_or_none(score.value) for score in result.scores}
        if result
        else {},
        "used": {sense: health.used for sense, health in result.health.items()} if result else {},
        "verdict": list(result.verdict) if result else [],
        "headline": dict(result.headline) if result else {},
        "faults": [_plain_fault(fault) for fault in result.faults] if result else [],
        "health": {name: _record_as_json(health) for name, health in result.health.items()}
        if result
        else {},
        "findings": [[f.severity, f.text] for f in dict.fromkeys(result.findings)]
        if result
        else [],
    }


def _record_as_json(record: Fault | Health) -> dict[str, Any]:
    """A record as JSON holds it, NaN as null."""
    return {
        key: _finite_or_none(v) if isinstance(v, float) else v for key, v in asdict(record).items()
    }


def _plain_fault(fault: Fault) -> dict[str, Any]:
    return {**_record_as_json(fault), "alternatives": list(fault.alternatives)}


def _finite_or_none(value: float) -> float | None:
    return float(value) if value - value == 0 else None
