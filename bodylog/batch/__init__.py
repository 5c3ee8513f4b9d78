"""Many logs, each with a learned body: every log gets its row, whatever happens to it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import UsageError
from ..files import made
from ..settings import Settings
from . import jobs, local, results, resume, work
from .jobs import Job, Row

Report = Callable[[Row, int, int], None]
"""Called with each finished row, how many are done and how many there are."""


@dataclass(frozen=True)
class Group:
    """Logs (files, folders, patterns) of one robot: its body, or what to learn it from, settings and bounds."""

    name: str
    logs: tuple[str, ...]
    settings: Settings
    body: Path | None = None
    train: tuple[Path, ...] = ()
    bounds: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """What a batch is asked to do, and with what: processes, bytes of memory, which part, on which scheduler."""

    groups: tuple[Group, ...]
    out: Path
    workers: int = 1
    shard: tuple[int, int] = (1, 1)
    resume: bool = False
    keep_going: bool = False
    memory: int | None = None
    scheduler: str | None = None


def batch(plan: Plan, report: Report | None = None) -> list[Row]:
    """One row per log, in name order; also left in plan.out as results.jsonl, junit.xml and summary.html."""
    planned = [job for group in plan.groups for job in _jobs(plan, group)]
    done = {job.name: row for job in planned if plan.resume and (row := resume.finished(job))}
    with results.journal(plan.out) as write:
        for row in done.values():
            write(row)
        for row in _run(plan, [job for job in planned if job.name not in done]):
            done[row["name"]] = row
            write(row)
            if report:
                report(row, len(done), len(planned))
    rows = [done.get(job.name) or work.not_run(job) for job in planned]
    results.write(plan.out, rows)
    return rows


def exit_code(rows: Sequence[Row]) -> int:
    """The worst kind met, from sound to our bug: 0, 3, 4, 65, 1."""
    return max((row["exit_code"] for row in rows), key=(0, 3, 4, 65, 1).index, default=0)


def _jobs(plan: Plan, group: Group) -> list[Job]:
    """The group's jobs; what no log can help is refused here: a bound, method or sense that is none, a body."""
    from .. import estimation
    from ..body import model
    from ..evaluation import bounds

    if (group.body is None) == (not group.train):
        raise UsageError("batch needs either --body body.npz or --train LOG, and not both")
    for text in group.bounds:
        bounds.parse(text)
    logs = jobs.named(group.logs, plan.shard)
    folder = made(plan.out / group.name)
    if taken := [folder / name for name in logs if (folder / name).is_file()]:
        raise UsageError(f"{taken[0]}: is in the place of a folder; give another one with -o")
    body = _body(group, folder)
    estimation.check(model.load(body), group.settings.estimate)
    before = f"{group.name}/" if group.name else ""
    return [
        Job(before + name, log, folder / name, body, group.settings, group.bounds, plan.resume)
        for name, log in logs.items()
    ]


def _run(plan: Plan, open_jobs: Sequence[Job]) -> Iterator[Row]:
    if plan.scheduler is not None:
        from . import cluster

        yield from cluster.run(open_jobs, plan.scheduler, plan.workers)
        return
    yield from local.run(open_jobs, min(plan.workers, max(1, len(open_jobs))), plan.memory, plan.keep_going)


def _body(group: Group, folder: Path) -> Path:
    """The body model given, or the one learned from the training logs, kept when it is what would be learned again."""
    if group.body is not None:
        return group.body
    with jobs.alone(folder):  # shards that share a folder learn the body once
        return resume.learned(group.train, folder / "body.npz", group.settings)

