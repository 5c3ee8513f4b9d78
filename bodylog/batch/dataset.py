"""Datasets and folders of logs for `doctor`: what is one, which of its episodes are examined, and
its results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..body import storage
from ..dataset import corrected_files, outputs, remedies
from ..errors import ModelError, UsageError
from ..evaluation import bounds as score_bounds
from ..io import episodes, remote
from ..io.atomic_files import write_text_atomically
from ..io.outputs import Output, guard_outputs
from ..io.temporary import create_scratch_folder
from ..io.values import read_json
from ..logs.datasets import kinds
from ..recording.lerobot_writer import new_folder
from ..settings import Settings
from ..types import Score
from . import BatchPlan, Group, Report, exit_code, folders, jobs, run_batch
from .jobs import Row


@dataclass(frozen=True)
class ExaminedDataset:
    """A dataset examined: the rows of its episodes, the row of the whole, and the exit code."""

    rows: tuple[Row, ...]
    whole: Row
    code: int


def holds_several_logs(log: Path | str) -> bool:
    """Whether a path holds several logs: a dataset's folder, a folder of logs, or a file of several
    episodes."""
    if (
        not isinstance(log, Path)
        or episodes.split_episode_name(log)[1] is not None
        or not log.exists()
    ):
        return False
    if log.is_dir():
        return kinds.is_episode_dataset(log) or (
            kinds.of_folder(log) is None and not jobs.is_rosbag2(log)
        )
    return len(kinds.episode_numbers(log)) > 1


def chosen_episodes(
    logs: Sequence[Path | str], begin: int | None, end: int | None
) -> tuple[str, ...]:
    """The logs in a dataset, in order; of numbered episodes those from `begin` to before `end`."""
    found = [log for given in logs for log in jobs.find_logs(str(given))]
    numbers = [
        None if remote.is_url(log) else episodes.split_episode_name(Path(log))[1] for log in found
    ]
    if begin is None and end is None:
        return tuple(found)
    if all(number is None for number in numbers):
        return tuple(found[begin:end])
    low = begin or 0
    high = float("inf") if end is None else end
    chosen = tuple(
        log
        for log, number in zip(found, numbers, strict=True)
        if number is not None and low <= number < high
    )
    if not chosen:
        there = [number for number in numbers if number is not None]
        raise UsageError(
            f"--episodes: none of them is there; possible: {min(there)} to {max(there)}"
        )
    return chosen


def examine_dataset(
    plan: BatchPlan, report: Report | None, page: Path | None, table: Path | None
) -> ExaminedDataset:
    """Examine all episodes of a plan; `page` and `table` are files to write beside plan.out."""
    files = [
        Output(path, option)
        for path, option in ((page, "-o"), (table, "--csv"))
        if path is not None
    ]
    bases = [Path(log) for group in plan.groups for log in group.logs if not remote.is_url(log)]
    guard_outputs([*plan.inputs, *bases], files)
    rows = run_batch(plan, report)
    whole = read_json((plan.out / folders.DATASET).read_text(encoding="utf-8"))
    if page is not None:
        text = (plan.out / folders.PAGE).read_text(encoding="utf-8")
        write_text_atomically(page, text)
    if table is not None:
        outputs.write_table(rows, table)
    _require_measured(plan, rows, whole)
    return ExaminedDataset(tuple(rows), whole, exit_code([*rows, whole]))


def fix_dataset(
    dataset: Path,
    out: Path,
    settings: Settings,
    repeats: str,
    exclude: str,
    workers: int,
    checked: Path | None,
    report: Report | None,
) -> tuple[str, ...]:
    """Write a corrected copy of a LeRobot folder as the new folder `out`, and return what was done
    in sentences.

    repeats, exclude: of choices.REPEATS and EXCLUDED · checked: the folder of an earlier
    examination, whose rows are used again where input, settings and version are the same.
    """
    new_folder(out)
    guard_outputs([dataset], [Output(out, folder=True)])
    with create_scratch_folder() as folder:
        logs = tuple(jobs.find_logs(str(dataset)))
        group = Group("", logs, settings, task=jobs.EXAMINE)
        rows_folder = folder / "rows" if checked is None else checked
        plan = BatchPlan(
            (group,), rows_folder, workers, resume=checked is not None, keep_going=True
        )
        rows = run_batch(plan, report)
        judged = outputs.judge_dataset(rows_folder, rows)
    base, chosen = remedies.choose_remedies(judged, settings, exclude)
    return corrected_files.write_corrected(base, chosen, out, repeats, settings)


def require_surface(body: Path) -> None:
    """ModelError for a body by which no episode can be judged beside the others."""
    if storage.load_body(body).surface is None:
        raise ModelError(
            f"{body}: it has no surface of a robot, by which episodes are judged; type: "
            "bodylog fit DATASET --urdf ROBOT.urdf -o body.npz"
        )


def examine_without_folder(
    plan: BatchPlan, report: Report | None, page: Path | None, table: Path | None
) -> ExaminedDataset:
    """As `examine_dataset`; the rows' folder is temporary."""
    with create_scratch_folder() as folder:
        return examine_dataset(replace(plan, out=folder / "rows"), report, page, table)


def _require_measured(plan: BatchPlan, rows: Sequence[Row], whole: dict[str, Any]) -> None:
    """UsageError for a bound that names no figure of any episode nor of the whole."""
    names = {name for row in (*rows, whole) for name in row["scores"]}
    figures = [Score(name, 0.0, "") for name in sorted(names)]
    for text in dict.fromkeys(text for group in plan.groups for text in group.bounds):
        bound = score_bounds.parse_bound(text)
        if not score_bounds.select_measured_bounds(figures, [bound]):
            possible = ", ".join(sorted({name.partition("/")[0] for name in names}))
            raise UsageError(
                f"--fail-if {text!r}: no episode has this score; measured were {possible}"
            )
