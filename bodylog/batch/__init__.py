"""Estimates for many logs: each log gets a row of results, whatever happens to it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import UsageError
from ..io import remote
from ..io.atomic_files import writable
from ..io.outputs import Output, guard
from ..settings import Settings
from . import folders, jobs, local, results, resume, work
from .jobs import ESTIMATE, EXAMINE, Job, Row

Report = Callable[[Row, int, int], None]
"""Called with each finished row, the number of finished rows and the number of all rows."""


@dataclass(frozen=True)
class Group:
    """Logs (files, folders, patterns) of one robot: its body, or what to learn it from, settings and bounds."""

    name: str
    logs: tuple[str, ...]
    settings: Settings
    body: Path | None = None
    train: tuple[Path, ...] = ()
    bounds: tuple[str, ...] = ()
    task: str = ESTIMATE


@dataclass(frozen=True)
class Plan:
    """The work of a batch and its resources: processes, memory (bytes), shard (I, N), Dask scheduler.

    `inputs` are further files that must not be written to: the manifest, a robot.toml.
    """

    groups: tuple[Group, ...]
    out: Path
    workers: int = 1
    shard: tuple[int, int] = (1, 1)
    resume: bool = False
    keep_going: bool = False
    memory: int | None = None
    scheduler: str | None = None
    inputs: tuple[Path, ...] = ()


def batch(plan: Plan, report: Report | None = None) -> list[Row]:
    """One row per log of this shard, in name order; plan.out gets results.jsonl, junit.xml and a
    page.

    Shards that share plan.out together leave the same files as one run over all logs.
    """
    every, names = _planned(plan)
    mine = [job for job in every if job.name in names]
    done = {job.name: row for job in mine if plan.resume and (row := resume.finished(job))}
    journal = results.Journal(plan.out, every, frozenset(names), done)
    for row in _run(plan, [job for job in mine if job.name not in done]):
        done[row["name"]] = row
        journal.add(row)
        if report:
            report(row, len(done), len(mine))
    for job in mine:
        if job.name not in done:
            done[job.name] = work.not_run(job)
    final = {row["name"]: row for row in journal.finish()}
    return [final.get(job.name, done[job.name]) for job in mine]


def exit_code(rows: Sequence[Row]) -> int:
    """The worst exit code of the rows, in the order 0, 3, 4, 65, 73, 74, 1."""
    return max((row["exit_code"] for row in rows), key=list(work.STATUS).index, default=0)


def _planned(plan: Plan) -> tuple[list[Job], set[str]]:
    """The jobs of all shards, and the names of this shard's jobs.

    Invalid bounds, methods, senses, bodies and output folders are rejected before any log is processed.
    """
    from ..evaluation import bounds

    logs = []
    for group in plan.groups:
        if group.task == ESTIMATE and (group.body is None) == (not group.train):
            raise UsageError("batch needs either --body body.npz or --train LOG, and not both")
        for text in group.bounds:
            bounds.parse(text)
        logs.append(jobs.named(group.logs, group.settings.input.max_wait_s))
    shares = [jobs.share(found, plan.shard) for found in logs]
    read = [path for found in logs for log in found.values() if (path := _path(log)) is not None]
    bodies = [path for group in plan.groups for path in (group.body, *group.train) if path is not None]
    guard([*plan.inputs, *read, *bodies], [Output(plan.out, folder=True)])
    writable(plan.out, folder=True)
    examines = any(group.task == EXAMINE for group in plan.groups)
    folders.check(plan.out, (), folders.WRITTEN if examines else folders.SUMMARIES)
    for group, found in zip(plan.groups, logs, strict=True):
        folders.check(plan.out / group.name, [plan.out / group.name / name for name in found])
        if group.train:
            resume.check_replaceable(plan.out / group.name / folders.BODY[0])
    checked: set[object] = set()
    for group in plan.groups:
        if group.body is not None:
            _check(group.body, group.settings, checked)
    folders.mark(plan.out, folders.BATCH)
    folders.claim(plan.out, _named(plan, logs))
    whole, names = [], set[str]()
    for group, found, share in zip(plan.groups, logs, shares, strict=True):
        before = f"{group.name}/" if group.name else ""
        whole += _jobs(plan, group, found, before)
        names.update(before + name for name in share)
    return whole, names


def _named(plan: Plan, logs: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """The logs of all groups by the names of their rows."""
    pairs = zip(plan.groups, logs, strict=True)
    return {f"{group.name}/{name}" if group.name else name: log for group, some in pairs for name, log in some.items()}


def _path(log: str) -> Path | None:
    """A log's path, None for a remote log."""
    return remote.file_behind(log) if remote.is_url(log) else Path(log)


def _check(body: Path, settings: Settings, checked: set[object]) -> None:
    """ModelError or UsageError for a damaged body, or a method or sense it cannot use; each pair is checked once."""
    from .. import estimation
    from ..body import storage

    asked = (body, repr(settings.estimate))
    if asked not in checked:
        estimation.check(storage.load(body), settings.estimate)
        checked.add(asked)


def _jobs(plan: Plan, group: Group, found: Mapping[str, str], before: str) -> list[Job]:
    folder = folders.mark(plan.out / group.name, folders.BATCH)
    body = _body(group, folder)
    how = resume.how(body, group.settings, group.bounds, group.task)
    common = (body, group.settings, group.bounds, plan.resume, how, group.task)
    return [Job(before + name, log, folder / name, *common) for name, log in found.items()]


def _run(plan: Plan, open_jobs: Sequence[Job]) -> Iterator[Row]:
    if plan.scheduler is not None:
        from . import cluster

        yield from cluster.run(open_jobs, plan.scheduler, plan.workers)
        return
    yield from local.run(open_jobs, min(plan.workers, max(1, len(open_jobs))), plan.memory, plan.keep_going)


def _body(group: Group, folder: Path) -> Path | None:
    """The given body model, or one learned from the training logs unless an earlier run left the same."""
    if group.body is not None or not group.train:
        return group.body
    with folders.alone(folder, folders.BATCH):  # shards that share a folder learn the body once
        body = resume.learned(group.train, folder / "body.npz", group.settings)
    _check(body, group.settings, set())
    return body
