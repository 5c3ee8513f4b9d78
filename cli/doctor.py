"""bodylog doctor."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import options
from .options import OUT, PATH, Common, common_options, logs_argument
from .setting_options import delay_option, setting_option

if TYPE_CHECKING:
    from bodylog.batch.dataset import ExaminedDataset
    from bodylog.batch.jobs import Row

_URDF = "Calibrate cameras, delays and joint zeros by the robot's own surface, without a marker."
_OUT = "Of a dataset: a page (.html), or a folder for the page, rows and junit.xml."


@click.command(epilog="Example: bodylog doctor crashed.mcap --repair sound.mcap")
@logs_argument
@click.option(
    "--repair", type=OUT, metavar="OUT.mcap", help="Write what is sound of one log there."
)
@click.option(
    "--body",
    type=PATH,
    help="Measure camera delays by this body, of a dataset also what differs from it; default: by "
    "one learned from the log.",
)
@setting_option("kinematics", "urdf", metavar="ROBOT.urdf|log", help=_URDF)
@click.option("-o", "--output", "out", type=options.PageOrFolder(), metavar="OUT", help=_OUT)
@click.option(
    "--csv",
    "table",
    type=OUT,
    metavar="FILE",
    help="Of a dataset: a row per episode, .csv or .parquet.",
)
@options.episodes_option
@options.jobs_option("Episodes")
@options.share_options("episode")
@options.fail_option
@delay_option
@common_options
def doctor(
    logs: tuple[Path, ...],
    repair: Path | None,
    body: Path | None,
    urdf: str | None,
    common: Common,
    as_json: bool,
    **typed: Any,
) -> int:
    """Examine a log or a dataset, and repair a log.

    It measures the delay of images relative to the joints
    in the middle minute of the log; --delay off skips this.

    LOG may be a dataset, or a folder of logs: then each episode is examined and compared with the
    others. Several logs are also judged together, by a body of the robot's own surface.
    """
    from bodylog.batch.dataset import holds_several_logs

    settings = common.settings(kinematics={"urdf": urdf})
    if repair is None and any(map(holds_several_logs, logs)):
        return _examine_dataset(logs, settings, common, body, as_json, typed)
    _refuse_dataset_options(logs, typed)
    return _examine_logs(logs, repair, body, settings, as_json)


def _refuse_dataset_options(logs: tuple[Path, ...], typed: dict[str, Any]) -> None:
    """UsageError for an option that a single log does not have; LogError where it is no log."""
    from bodylog.logs import open as open_log

    given = {
        "-o": typed["out"], "--csv": typed["table"], "--episodes": typed["episodes"],
        "--resume": typed["resume"], "--scheduler": typed["scheduler"],
        "--fail-if": typed["bounds"], "--shard": typed["shard"] != "1/1",
        "--jobs": typed["workers"] > 1,
    }  # fmt: skip
    for option, value in given.items():
        if value:
            for log in logs:
                open_log(log).close()
            raise click.UsageError(
                f"{option} is for a dataset or a folder of logs, without --repair"
            )


def _examine_logs(
    logs: tuple[Path, ...], repair: Path | None, body: Path | None, settings: Any, as_json: bool
) -> int:
    from bodylog import pipeline

    from .output import (
        collect_results,
        exit_code_of_findings,
        print_json,
        print_line,
        result_entry,
        show_progress,
    )

    if repair is not None and len(logs) != 1:
        raise click.UsageError("--repair takes exactly one LOG")
    with show_progress("doctor", logs, settings, "messages") as tick:
        results, code = collect_results(
            logs, lambda log: pipeline.diagnose_log(log, repair, settings, tick, body)
        )
    whole = None if body is None else pipeline.diagnose_together([*results.values()], body)
    if whole is not None:
        results[" ".join(results)] = whole
    if as_json:
        print_json([result_entry(result, path) for path, result in results.items()])
    else:
        for path, result in results.items():
            count = sum(finding.severity != "info" for finding in result.findings)
            finding_count = "1 finding" if count == 1 else f"{count} findings"
            quiet = "nothing in common" if result is whole else "sound"
            print_line(f"{path}: {finding_count if count else quiet}")
            for finding in result.findings:
                print_line(f"  {finding.severity}: {finding.text}")
    return code or max(exit_code_of_findings(result.findings) for result in results.values())


def _examine_dataset(
    logs: tuple[Path, ...],
    settings: Any,
    common: Common,
    body: Path | None,
    as_json: bool,
    typed: dict[str, Any],
) -> int:
    from bodylog.batch import BatchPlan, Group, dataset
    from bodylog.batch.jobs import EXAMINE

    from .batch import parse_shard, print_row
    from .output import print_json, read_verbosity

    out: Path | None = typed["out"]
    folder = out is not None and not options.PageOrFolder.is_page(out)
    if not folder and (typed["resume"] or typed["scheduler"] or typed["shard"] != "1/1"):
        raise click.UsageError(
            "--resume, --shard and --scheduler need a folder for the rows; type: -o DIR"
        )
    begin, end = typed["episodes"] or (None, None)
    chosen = dataset.chosen_episodes(logs, begin, end)
    if body is not None:
        dataset.require_surface(body)
    group = Group("", chosen, settings, body=body, bounds=typed["bounds"], task=EXAMINE)
    read = () if common.config_file is None else (common.config_file,)
    plan = BatchPlan(
        groups=(group,),
        out=out if folder and out is not None else Path(),
        workers=typed["workers"],
        shard=parse_shard(typed["shard"]),
        resume=typed["resume"],
        keep_going=True,
        scheduler=typed["scheduler"],
        inputs=read,
    )
    run = dataset.examine_dataset if folder else dataset.examine_without_folder
    found = run(plan, print_row, None if folder else out, typed["table"])
    if as_json:
        print_json(
            [*map(_doctor_entry, found.rows), _doctor_entry(found.whole, " ".join(map(str, logs)))]
        )
    elif read_verbosity() >= 0:
        _print_verdict(found)
    return found.code


def _print_verdict(found: "ExaminedDataset") -> None:
    """The verdict, the episodes that stand out, then what each episode says of itself."""
    from .output import print_line, read_verbosity

    for text in found.whole["verdict"]:
        print_line(text)
    for one in found.whole["outliers"]:
        print_line(f"  {one['episode']}: {one['text']}")
    if found.whole["error"]:
        print_line(f"bodylog: {found.whole['error']}", err=True)
    odd = {one["text"] for one in found.whole["outliers"]}
    for row in found.rows:
        texts = [
            text for severity, text in row["findings"] if severity != "info" and text not in odd
        ]
        why = f": {row['error'].strip().splitlines()[-1]}" if row["error"] else ""
        print_line(f"{row['exit_code']:>3}  {row['name']}  {row['status']}{why}")
        for text in texts if read_verbosity() > 0 else ():
            print_line(f"       {text}")


def _doctor_entry(row: "Row", source: str | None = None) -> dict[str, Any]:
    """A row as one of the envelope's results; its name, status, exit code and error stand
    beside."""
    from bodylog.score_names import score_unit

    scores = {
        name: {"value": value, "unit": score_unit(name)}
        | ({"std": row["scores"][f"std/{name}"]} if f"std/{name}" in row["scores"] else {})
        for name, value in row["scores"].items()
    }
    return {
        "input": row["log"] if source is None else source,
        "output": None,
        "verdict": row["verdict"],
        "scores": scores,
        "health": row.get("health", {}),
        "findings": [{"severity": severity, "text": text} for severity, text in row["findings"]],
        "faults": row.get("faults", []),
        "settings": {},
        **{key: row[key] for key in ("name", "status", "exit_code", "error")},
        **({"outliers": row["outliers"]} if "outliers" in row else {}),
    }
