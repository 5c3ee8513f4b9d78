"""bodylog plot."""

from pathlib import Path

import click

from .options import OUT, PATH, Common, common_options, episode_option
from .setting_options import clock_option


@click.command(epilog="Example: bodylog plot run.bag -o run.png")
@click.argument("source", metavar="LOG|BODY.npz", type=PATH)
@episode_option("source")
@click.option(
    "-o", "--output", "out", type=OUT, required=True, help="The picture to write (.png or .svg)."
)
@clock_option
@common_options
def plot(source: Path, out: Path, common: Common, as_json: bool) -> int:
    """Draw a log or a body model as a figure.

    A log: joints, pixels, skin, touches, trajectories. A body model: mean and variance.
    """
    from bodylog import views

    from .output import print_result, show_progress

    chosen = common.settings()
    with show_progress("plot", [source], chosen) as tick:
        result = views.draw_log_or_body(source, out, chosen, tick)
    return print_result(result, source, as_json)
