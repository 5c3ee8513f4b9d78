"""bodylog estimate."""

from pathlib import Path
from typing import Any

import click

from . import options


@click.command(epilog="Example: bodylog estimate run.bag --body body.npz -o run.mcap --method smoother")
@options.log_argument
@click.option("--body", type=options.PATH, required=True, help="The body model that fit wrote.")
@options.out_option("The annotated MCAP to write.")
@options.estimation_options
@options.fast_option
@options.clock_option
@options.delay_option
@options.common_options
def estimate(
    log: Path, body: Path, out: Path, fast: bool | None, common: options.Common, as_json: bool, **typed: Any
) -> int:
    """Replay a log: where the body was, how sure that is, and which sensor lied; written back as an annotated MCAP."""
    from bodylog import pipeline

    from .output import progress, show

    chosen = common.settings(colours={"fast": fast}, estimate=options.estimation(typed))
    with progress("estimate") as tick:
        result = pipeline.estimate(log, body, out, chosen, tick)
    return show(result, as_json)
