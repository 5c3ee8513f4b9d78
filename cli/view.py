"""bodylog view."""

from pathlib import Path

import click

from .options import OUT, Common, common_options, log_argument


@click.command(epilog="Example: bodylog view run.mcap -o run.rrd")
@log_argument
@click.option(
    "-o",
    "--output",
    "out",
    type=OUT,
    help="The recording to write (.rrd); without it a window opens.",
)
@common_options
def view(log: Path, out: Path | None, common: Common, as_json: bool) -> int:
    """Show a log in Rerun, with overlays.

    It shows images with measured and predicted places, the estimate, errors and events.
    """
    from bodylog import views

    from .output import print_result, show_progress

    with show_progress("view", [log], unit="steps", count=lambda _: 4) as tick:
        result = views.show_in_rerun(log, out, common.settings(), tick)
    return print_result(result, log, as_json)
