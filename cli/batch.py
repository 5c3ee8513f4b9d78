"""bodylog batch."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import options
from .setting_options import clock_option, delay_option, estimation_as_typed, estimation_options

if TYPE_CHECKING:
    from bodylog.batch import Group
    from bodylog.settings import Settings


@click.command(
    epilog="Example: bodylog batch logs/ -o out --train explore.bag --jobs 2 --fail-if "
    "'rmse/joint>0.02'"
)
@click.argument("logs", metavar="LOG|GLOB|DIR...", type=options.SEARCHED, nargs=-1, required=True)
@click.option(
    "-o", "--output", "out", type=options.FOLDER, required=True, help="The folder for everything."
)
@click.option("--body", type=options.PATH, help="The body model that fit wrote.")
@click.option(
    "--train",
    type=options.PATH,
    multiple=True,
    metavar="LOG",
    help="Learn the body from this log first.",
)
@options.jobs_option("Logs")
@click.option("--memory", metavar="SIZE", help="Memory for all of them together, e.g. 4G.")
@options.share_options("log")
@click.option("--keep-going", is_flag=True, help="Go on to further logs even after a bug of ours.")
@options.episode_option("logs")
@options.fail_option
@estimation_options
@clock_option
@delay_option
@options.common_options
def batch(
    logs: tuple[str, ...],
    memory: str | None,
    shard: str,
    common: options.Common,
    as_json: bool,
    **typed: Any,
) -> int:
    """Estimate, score and report on many logs.

    Each log gets a row in results.jsonl, junit.xml and summary.html.

    A single batch.toml instead of logs names groups of
    them, each with its own body, methods and bounds.
    """
    from bodylog.batch import BatchPlan, exit_code
    from bodylog.batch import run_batch as run

    from .output import print_json, read_verbosity

    how = {key: typed.pop(key) for key in ("out", "workers", "scheduler", "resume", "keep_going")}
    what = {key: typed.pop(key) for key in ("body", "train", "bounds")}
    groups = _groups_to_run(logs, common.settings(estimate=estimation_as_typed(typed)), what)
    read = tuple(
        path
        for path in (*map(Path, logs), common.config_file)
        if path is not None and path.is_file()
    )
    plan = BatchPlan(
        groups=groups, shard=parse_shard(shard), memory=_parse_bytes(memory), inputs=read, **how
    )
    rows = run(plan, print_row)
    if as_json:
        print_json([_batch_entry(row, plan.out) for row in rows])
    elif read_verbosity() >= 0:
        _print_summary(rows, plan.out)
    return exit_code(rows)


def _groups_to_run(
    logs: tuple[str, ...], settings: "Settings", what: dict[str, Any]
) -> "tuple[Group, ...]":
    from bodylog.batch import Group, manifest

    if not any(log.endswith(".toml") for log in logs):
        return (Group("", logs, settings, **what),)
    if len(logs) > 1 or any(what.values()):
        raise click.UsageError(
            "a batch.toml stands alone: it names the logs, bodies and bounds itself"
        )
    return manifest.load_manifest(Path(logs[0]), settings)


def print_row(row: dict[str, Any], done: int, total: int) -> None:
    """Print a finished row on standard error."""
    from .output import print_line, read_verbosity

    if read_verbosity() >= 0:
        print_line(
            f"[{done}/{total}] {row['name']}: {row['status']}{_row_error_text(row)}", err=True
        )


def _row_error_text(row: dict[str, Any]) -> str:
    return f": {row['error'].strip().splitlines()[-1]}" if row["error"] else ""


def _print_summary(rows: list[dict[str, Any]], out: Path) -> None:
    """The verdict on all logs, then a row for each: exit code, error (rad), name, status."""
    from bodylog.findings.verdict import verdict_of_batch

    from .output import print_line

    for text in verdict_of_batch(rows):
        print_line(text)
    for row in rows:
        found = row["scores"].get("rmse/joint")
        error = "-" if found is None else f"{found:.4g} rad"
        print_line(
            f"{row['exit_code']:>3}  {error:>12}  {row['name']}  "
            f"{row['status']}{_row_error_text(row)}"
        )
    print_line(f"wrote {out / 'summary.html'}", err=True)


def _batch_entry(row: dict[str, Any], out: Path) -> dict[str, Any]:
    """A row as one of the envelope's results; name, status, exit code and error stand beside."""
    from bodylog.score_names import score_unit

    log = out / row["name"] / "annotated.mcap"
    return {
        "input": row["log"],
        "output": str(log) if log.name in row["outputs"] else None,
        "verdict": row["verdict"],
        "scores": {
            name: {"value": value, "unit": score_unit(name)}
            for name, value in row["scores"].items()
        },
        "health": row["health"],
        "findings": [{"severity": severity, "text": text} for severity, text in row["findings"]],
        "faults": row["faults"],
        "settings": {},
        **{key: row[key] for key in ("name", "status", "exit_code", "error")},
    }


def parse_shard(text: str) -> tuple[int, int]:
    """The shard that I/N names."""
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if not found:
        raise click.BadParameter(f"{text!r}; it must be I/N, e.g. 2/4", param_hint="--shard")
    return int(found[1]), int(found[2])


def _parse_bytes(text: str | None) -> int | None:
    if text is None:
        return None
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([KMGT]?)B?", text.upper())
    if not found or not float(found[1]):
        raise click.BadParameter(f"{text!r}; it must be a size, e.g. 4G", param_hint="--memory")
    return int(float(found[1]) * 1024 ** " KMGT".index(found[2] or " "))
