"""bodylog evaluate."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .options import PATH, Common, all_option, common_options, fail_option, logs_argument

if TYPE_CHECKING:
    from bodylog.pipeline import Result

COLUMNS = ("rmse/joint", "rmse/encoders", "nees/joint", "coverage_2sigma/joint", "faults")
"""Scores in the table of several logs."""


@click.command(epilog="Example: bodylog evaluate run.mcap --fail-if 'rmse/joint>0.02'")
@logs_argument
@fail_option
@click.option("--truth", type=PATH, metavar="FILE", help="True angles kept elsewhere: .csv, .npz or a log.")
@click.option("--baseline", type=PATH, metavar="RESULTS.jsonl", help="A batch's results to be no worse than.")
@click.option("--tolerance", default="5%", show_default=True, help="By how much an error may grow over the baseline.")
@all_option
@common_options
def evaluate(
    logs: tuple[Path, ...],
    bounds: tuple[str, ...],
    truth: Path | None,
    baseline: Path | None,
    tolerance: str,
    full: bool,
    common: Common,
    as_json: bool,
) -> int:
    """Score estimates against the truth.

    LOG is what estimate wrote. One log: a verdict; several: a table with a row for each. The truth is the log's own or
    --truth. The baseline finds a log OUT/NAME/annotated.mcap of a batch by NAME.
    """
    from bodylog import pipeline
    from bodylog.errors import BoundError
    from bodylog.evaluation import baseline as earlier
    from bodylog.evaluation import bounds as rules

    from .output import each, entry, lost, print_error, print_json, warn

    wanted, share = [rules.parse(text) for text in bounds], earlier.tolerance(tolerance)
    before = earlier.load(baseline) if baseline else None
    chosen = common.settings()
    results, refused = each(logs, lambda log: pipeline.evaluate(log, chosen, truth))
    if as_json:
        print_json([entry(result, path) for path, result in results.items()])
        warn([finding for result in results.values() for finding in result.findings])
    else:
        _print(results, full)
    try:
        rules.check({path: result.figures for path, result in results.items()}, wanted)
        if before is not None:
            earlier.check({_name(log): results[str(log)].scores for log in logs if str(log) in results}, before, share)
    except BoundError as broken:
        if not refused:
            raise
        print_error(broken)
    return refused or max(lost(result.findings) for result in results.values())


def _name(log: Path) -> str:
    return log.parent.name if log.name == "annotated.mcap" else log.name


def _print(results: "dict[str, Result]", full: bool) -> None:
    """The verdict of one log, or a row for each of several; with --all every score."""
    from .output import columns, score_table, show_verdict, verbosity, warn

    if len(results) == 1:
        show_verdict(next(iter(results.values())))
    elif verbosity() >= 0:
        rows = [[path, *(_cell(result, name) for name in COLUMNS)] for path, result in results.items()]
        columns([["log", *COLUMNS], ["", *map(_unit, COLUMNS)], *rows], left=1)
        for path, result in results.items():
            warn(result.findings, f"{path}: ")
    if full and verbosity() >= 0:
        score_table({path: result.scores for path, result in results.items()})


def _unit(name: str) -> str:
    from bodylog.score_names import unit

    return unit(name)


def _cell(result: "Result", name: str) -> str:
    values = {score.name: score.value for score in (*result.scores, *result.figures)}
    return f"{values[name]:.4g}" if name in values else "-"
