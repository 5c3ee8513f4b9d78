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
@click.option(
    "--truth", type=PATH, metavar="FILE", help="True angles kept elsewhere: .csv, .npz or a log."
)
@click.option(
    "--baseline", type=PATH, metavar="RESULTS.jsonl", help="A batch's results to be no worse than."
)
@click.option(
    "--tolerance",
    default="5%",
    show_default=True,
    help="By how much an error may grow over the baseline.",
)
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

    LOG is what estimate wrote. One log: a verdict; several: a
    table with a row for each. The truth is the log's own or
    --truth. The baseline finds a log OUT/NAME/annotated.mcap of a batch by NAME.
    """
    from bodylog import pipeline
    from bodylog.errors import BoundError
    from bodylog.evaluation import baseline as earlier
    from bodylog.evaluation import bounds as rules

    from .output import (
        collect_results,
        exit_code_of_findings,
        print_error,
        print_findings,
        print_json,
        result_entry,
    )

    wanted = [rules.parse_bound(text) for text in bounds]
    share = earlier.parse_tolerance(tolerance)
    before = earlier.load_baseline(baseline) if baseline else None
    chosen = common.settings()
    results, refused = collect_results(logs, lambda log: pipeline.evaluate(log, chosen, truth))
    if as_json:
        print_json([result_entry(result, path) for path, result in results.items()])
        print_findings([finding for result in results.values() for finding in result.findings])
    else:
        _print_scores(results, full)
    try:
        rules.check_bounds({path: result.figures for path, result in results.items()}, wanted)
        if before is not None:
            earlier.check_against_baseline(
                {_log_name(log): results[str(log)].scores for log in logs if str(log) in results},
                before,
                share,
            )
    except BoundError as broken:
        if not refused:
            raise
        print_error(broken)
    return refused or max(exit_code_of_findings(result.findings) for result in results.values())


def _log_name(log: Path) -> str:
    return log.parent.name if log.name == "annotated.mcap" else log.name


def _print_scores(results: "dict[str, Result]", full: bool) -> None:
    """The verdict of one log, or a row for each of several; with --all every score."""
    from .output import (
        print_columns,
        print_findings,
        print_score_table,
        print_verdict,
        read_verbosity,
    )

    if len(results) == 1:
        print_verdict(next(iter(results.values())))
    elif read_verbosity() >= 0:
        rows = [
            [path, *(_result_cell(result, name) for name in COLUMNS)]
            for path, result in results.items()
        ]
        print_columns([["log", *COLUMNS], ["", *map(_unit_of_column, COLUMNS)], *rows], left=1)
        for path, result in results.items():
            print_findings(result.findings, f"{path}: ")
    if full and read_verbosity() >= 0:
        print_score_table({path: result.scores for path, result in results.items()})


def _unit_of_column(name: str) -> str:
    from bodylog.score_names import score_unit

    return score_unit(name)


def _result_cell(result: "Result", name: str) -> str:
    values = {score.name: score.value for score in (*result.scores, *result.figures)}
    return f"{values[name]:.4g}" if name in values else "-"
