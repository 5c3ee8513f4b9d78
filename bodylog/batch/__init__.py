"""Estimates for many logs: each log gets a row of results, whatever happens to it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import UsageError
from ..io import remote
from ..io.atomic_files import require_writable
from ..io.outputs import Output, guard_outputs
from ..settings import Settings
from . import folders, jobs, local, results, resume, work
from .jobs import ESTIMATE, EXAMINE, Job, Row

Report = Callable[[Row, int, int], None]
"""Called with each finished row, the number of finished rows and the number of all rows."""


@dataclass(frozen=True)
class Group:
    """Logs (files, folders, patterns) of one robot: its
    body, or what to learn it from, settings and bounds.
    """

    name: str
    logs: tuple[str, ...]
    settings: Settings
    body: Path | None = None
    train: tuple[Path, ...] = ()
    bounds: tuple[str, ...] = ()
    task: str = ESTIMATE


@dataclass(frozen=True)
class BatchPlan:
    """The work of a batch and its resources: processes,
    memory (bytes), shard (I, N), Dask scheduler.

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


def run_batch(plan: BatchPlan, report: Report | None = None) -> list[Row]:
    """One row per log of this shard, in name order; plan.out gets results.jsonl, junit.xml and a
    page.

    Shards that share plan.out together leave the same files as one run over all logs.
    """
    every, names = _plan_jobs(plan)
    mine = [job for job in every if job.name in names]
    done = {job.name: row for job in mine if plan.resume and (row := resume.read_finished_row(job))}
    journal = results.Journal(plan.out, every, frozenset(names), done)
    for row in _run_open_jobs(plan, [job for job in mine if job.name not in done]):
        done[row["name"]] = row
        journal.add(row)
        if report:
            report(row, len(done), len(mine))
    for job in mine:
        if job.name not in done:
            done[job.name] = work.write_skipped_row(job)
    final = {row["name"]: row for row in journal.finish()}
    return [final.get(job.name, done[job.name]) for job in mine]


def exit_code(rows: Sequence[Row]) -> int:
    """The worst exit code of the rows, in the order 0, 3, 4, 65, 73, 74, 1."""
    return max((row["exit_code"] for row in rows), key=list(work.STATUS).index, default=0)


def _plan_jobs(plan: BatchPlan) -> tuple[list[Job], set[str]]:
    """The jobs of all shards, and the names of this shard's jobs.

    Invalid bounds, methods, senses, bodies and output
    folders are rejected before any log is processed.
    """
    from ..evaluation import bounds

    logs = []
    for group in plan.groups:
        if group.task == ESTIMATE and (group.body is None) == (not group.train):
            raise UsageError("batch needs either --body body.npz or --train LOG, and not both")
        for text in group.bounds:
            bounds.parse_bound(text)
        logs.append(jobs.name_logs(group.logs, group.settings.input.max_wait_s))
    shares = [jobs.select_shard(found, plan.shard) for found in logs]
    read = [
        path
        for found in logs
        for log in found.values()
        if (path := (remote.file_behind(log) if remote.is_url(log) else Path(log))) is not None
    ]
    bodies = [
        path for group in plan.groups for path in (group.body, *group.train) if path is not None
    ]
    guard_outputs([*plan.inputs, *read, *bodies], [Output(plan.out, folder=True)])
    require_writable(plan.out, folder=True)
    examines = any(group.task == EXAMINE for group in plan.groups)
    folders.check_batch_folder(plan.out, (), folders.WRITTEN if examines else folders.SUMMARIES)
    for group, found in zip(plan.groups, logs, strict=True):
        folders.check_batch_folder(
            plan.out / group.name, [plan.out / group.name / name for name in found]
        )
        if group.train:
            resume.check_replaceable(plan.out / group.name / folders.BODY[0])
    checked: set[object] = set()
    for group in plan.groups:
        if group.body is not None:
            _check_body_and_settings(group.body, group.settings, checked)
    folders.mark_folder(plan.out, folders.BATCH)
    folders.claim_folder(plan.out, _name_logs_of_groups(plan, logs))
    whole = []
    names = set[str]()
    for group, found, share in zip(plan.groups, logs, shares, strict=True):
        before = f"{group.name}/" if group.name else ""
        whole += _list_group_jobs(plan, group, found, before)
        names.update(before + name for name in share)
    return whole, names


def _name_logs_of_groups(plan: BatchPlan, logs: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """The logs of all groups by the names of their rows."""
    pairs = zip(plan.groups, logs, strict=True)
    return {
        f"{group.name}/{name}" if group.name else name: log
        for group, some in pairs
        for name, log in some.items()
    }


def _check_body_and_settings(body: Path, settings: Settings, checked: set[object]) -> None:
    """ModelError or UsageError for a damaged body, or a
    method or sense it cannot use; each pair is checked once.
    """
    from .. import estimation
    from ..body import storage

    asked = (body, repr(settings.estimate))
    if asked not in checked:
        estimation.check_estimation_settings(storage.load_body(body), settings.estimate)
        checked.add(asked)


def _list_group_jobs(
    plan: BatchPlan, group: Group, found: Mapping[str, str], before: str
) -> list[Job]:
    folder = folders.mark_folder(plan.out / group.name, folders.BATCH)
    body = _given_or_learned_body(group, folder)
    how = resume.settings_digest(body, group.settings, group.bounds, group.task)
    common = (body, group.settings, group.bounds, plan.resume, how, group.task)
    return [Job(before + name, log, folder / name, *common) for name, log in found.items()]


def _run_open_jobs(plan: BatchPlan, open_jobs: Sequence[Job]) -> Iterator[Row]:
    if plan.scheduler is not None:
        from . import cluster

        yield from cluster.run_on_cluster(open_jobs, plan.scheduler, plan.workers)
        return
    yield from local.run_on_this_machine(
        open_jobs, min(plan.workers, max(1, len(open_jobs))), plan.memory, plan.keep_going
    )


def _given_or_learned_body(group: Group, folder: Path) -> Path | None:
    """The given body model, or one learned from the
    training logs unless an earlier run left the same.
    """
    if group.body is not None or not group.train:
        return group.body
    with folders.lock_folder(folder, folders.BATCH):
        # shards that share a folder learn the body once
        body = resume.learn_body_once(group.train, folder / "body.npz", group.settings)
    _check_body_and_settings(body, group.settings, set())
    return body
