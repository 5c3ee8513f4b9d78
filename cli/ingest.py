"""bodylog ingest."""

from pathlib import Path

import click

from .options import FOLDER, Common, common_options, log_argument, out_option, window_options


@click.command(epilog="Example: bodylog ingest run.bag -o tidy.mcap --start 2 --end 30")
@log_argument
@out_option("The tidy MCAP to write.")
@window_options
@click.option(
    "--csv", type=FOLDER, metavar="DIR", help="Also write the signals there, a CSV file per role."
)
@click.option("--parquet", type=FOLDER, metavar="DIR", help="Also write them as Parquet.")
@common_options
def ingest(
    log: Path,
    out: Path,
    start: float | None,
    end: float | None,
    csv: Path | None,
    parquet: Path | None,
    common: Common,
    as_json: bool,
) -> int:
    """Write a log as one tidy MCAP with named roles."""
    from bodylog import pipeline

    from .output import print_result, show_progress

    if start is not None and end is not None and start >= end:
        raise click.BadParameter(f"{start:g} s is not before --end {end:g}", param_hint="--start")
    tables = {
        form: folder for form, folder in (("csv", csv), ("parquet", parquet)) if folder is not None
    }
    settings = common.settings()
    with show_progress("ingest", [log], settings) as tick:
        result = pipeline.ingest(log, out, settings, tables, tick, start=start, end=end)
    return print_result(result, log, as_json)
