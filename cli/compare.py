"""bodylog compare."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import options
from .setting_options import clock_option, delay_option

if TYPE_CHECKING:
    from collections.abc import Callable

    from bodylog.compare import ComparisonRow

COLUMNS = (
    "rmse/joint",
    "nees/joint",
    "coverage_2sigma/joint",
    "log_evidence",
    "log_density/held_out",
)
WIDTH = max(map(len, COLUMNS))


@click.command(epilog="Example: bodylog compare run.bag --body body.npz")
@options.log_argument
@click.option("--body", type=options.PATH, required=True, help="The body model that fit wrote.")
@clock_option
@delay_option
@click.option(
    "--all",
    "full",
    is_flag=True,
    help="Run senses without the encoders too; takes several times longer.",
)
@options.common_options
def compare(log: Path, body: Path, full: bool, common: options.Common, as_json: bool) -> int:
    """Compare every method and set of senses on a log.

    The sets are the encoders with each set of the other senses; --all adds those without the
    encoders. log_density/held_out needs no truth: the mean log density (nats) of images withheld
    from the method, one in five. Compare log_evidence between rows of the same senses. seconds are
    processor time of the estimate.
    """
    from bodylog import compare as comparison
    from bodylog.pipeline import Result

    from .output import (
        exit_code_of_findings,
        print_findings,
        print_json,
        result_entry,
        show_progress,
    )

    chosen = common.settings()
    with show_progress("compare", [log], chosen) as tick:
        rows, findings = comparison.compare_methods(
            log, body, chosen, tick, None if as_json else _row_printer(), full
        )
    print_findings(findings)
    if as_json:
        print_json(
            [
                result_entry(Result(None, findings=findings), log)
                | {"rows": [_comparison_as_json(row) for row in rows]}
            ]
        )
    return exit_code_of_findings(findings)


def _comparison_as_json(row: "ComparisonRow") -> dict[str, Any]:
    from .output import scores_by_name

    scores = scores_by_name(row.scores)
    return {"method": row.method, "senses": row.senses, "seconds": row.seconds, "scores": scores}


def _row_printer() -> "Callable[[ComparisonRow], None]":
    """A function that prints a row, and the names and units of the columns before the first one."""
    from bodylog.score_names import score_unit

    heads = [("", "", *map(score_unit, COLUMNS), "s"), ("method", "senses", *COLUMNS, "seconds")]

    def line(row: "ComparisonRow") -> None:
        scores = {score.name: score.value for score in row.scores}
        cells = " ".join(
            f"{scores[name]:>{WIDTH}.5g}" if name in scores else f"{'-':>{WIDTH}}"
            for name in COLUMNS
        )
        while heads:
            method, senses, *names, seconds = heads.pop()
            named = " ".join(f"{name:>{WIDTH}}" for name in names)
            click.echo(f"{method:<18} {senses:<24} {named} {seconds:>9}")
        click.echo(f"{row.method:<18} {','.join(row.senses):<24} {cells} {row.seconds:>9.3f}")

    return line
