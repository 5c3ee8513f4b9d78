"""bodylog ingest."""

from pathlib import Path

import click

from .options import common_options, log_argument, out_option, settings


@click.command(epilog="Example: bodylog ingest run.bag -o tidy.mcap --start 2 --end 30")
@log_argument
@out_option("The tidy MCAP to write.")
@click.option("--start", type=float, metavar="S", help="Leave out what came before (s since start).")
@click.option("--end", type=float, metavar="S", help="Leave out what came after.")
@common_options
def ingest(
    log: Path, out: Path, start: float | None, end: float | None, config_file: Path | None, as_json: bool
) -> int:
    """Turn any recorded log into one tidy MCAP with its roles named and its times chosen."""
    from bodylog import pipeline

    from .output import show

    return show(pipeline.ingest(log, out, settings(config_file), start=start, end=end), as_json)
