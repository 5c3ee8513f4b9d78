"""bodylog report."""

from pathlib import Path

import click

from .options import FOLDER, Common, all_option, common_options, log_argument, out_option


@click.command(epilog="Example: bodylog report run.mcap -o report.html")
@log_argument
@out_option("The page to write (.html).")
@click.option(
    "--figures",
    type=FOLDER,
    metavar="DIR",
    help="Also draw figures (PNG and SVG) into this folder.",
)
@all_option
@common_options
def report(
    log: Path, out: Path, figures: Path | None, full: bool, common: Common, as_json: bool
) -> int:
    """Write an HTML page on an annotated log."""
    from bodylog import views

    from .output import print_result, show_progress

    steps = 3 if figures is None else 4
    with show_progress("report", [log], unit="steps", count=lambda _: steps) as tick:
        result = views.write_report(log, out, common.settings(), figures, tick)
    return print_result(result, log, as_json, full)
