"""bodylog extract."""

from pathlib import Path

import click

from .options import FOLDER, Common, common_options, log_argument, out_option
from .setting_options import clock_option, fast_option


@click.command(epilog="Example: bodylog extract run.bag -o features.mcap")
@log_argument
@out_option("The features MCAP to write.")
@click.option(
    "--csv",
    type=FOLDER,
    metavar="DIR",
    help="Also write tracks, touches, strokes and synchrony there as CSV.",
)
@fast_option
@clock_option
@common_options
def extract(
    log: Path, out: Path, csv: Path | None, fast: bool | None, common: Common, as_json: bool
) -> int:
    """Write tracks and touches without the images.

    Tracks of features, touches, strokes and their synchrony stand beside the signals.
    """
    from bodylog import pipeline

    from .output import print_result, show_progress

    chosen = common.settings(colours={"fast": fast})
    with show_progress("extract", [log], chosen) as tick:
        result = pipeline.extract(log, out, chosen, tick, csv)
    return print_result(result, log, as_json)
