"""bodylog compare."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import options
from .setting_options import clock_option, delay_option

if TYPE_CHECKING:
    from collections.abc import Callable

    from bodylog.compare import Row

COLUMNS = ("rmse/joint", "nees/joint", "coverage_2sigma/joint", "log_evidence", "log_density/held_out")


@click.command(epilog="Example: bodylog compare run.bag --body body.npz")
@options.log_argument
@click.option("--body", type=options.PATH, required=True, help="The body model that fit wrote.")
@clock_option
@delay_option
@options.common_options
def compare(log: Path, body: Path, common: options.Common, as_json: bool) -> int:
    """Every method with every subset of senses on one log, in one table.

    log_density/held_out needs no truth: the mean log density (nats) of images withheld from the method, one in five.
    log_evidence is about what a row heard: hold it against rows of the same senses. seconds are of the processor, for
    the estimate alone.
    """
    from bodylog import compare as comparison
    from bodylog.pipeline import Result

    from .output import as_data, data, lost, progress, talk

    with progress("compare") as tick:
        rows, findings = comparison.compare(log, body, common.settings(), tick, None if as_json else _line())
    talk(findings)
    if as_json:
        data(as_data(Result(None, findings=findings)) | {"rows": [_plain(row) for row in rows]})
    return lost(findings)


def _plain(row: "Row") -> dict[str, Any]:
    scores = {score.name: score.value for score in row.scores}
    return {"method": row.method, "senses": row.senses, "seconds": row.seconds, "scores": scores}


def _line() -> "Callable[[Row], None]":
    """Prints a row of the table, before the first one what its columns are."""
    head = [f"{'method':<18} {'senses':<24} " + " ".join(f"{name:>15}" for name in COLUMNS) + f" {'seconds':>9}"]

    def line(row: "Row") -> None:
        scores = {score.name: score.value for score in row.scores}
        cells = " ".join(f"{scores[name]:>15.5g}" if name in scores else f"{'-':>15}" for name in COLUMNS)
        while head:
            click.echo(head.pop())
        click.echo(f"{row.method:<18} {','.join(row.senses):<24} {cells} {row.seconds:>9.3f}")

    return line
