"""bodylog layout."""

from pathlib import Path

import click

from .options import Common, common_options, log_argument, out_option


@click.command(epilog="Example: bodylog layout run.mcap -o bodylog.json")
@log_argument
@out_option("The layout to write (.json).")
@common_options
def layout(log: Path, out: Path, common: Common, as_json: bool) -> int:
    """Write a Foxglove layout for an annotated log.

    It shows the image with its overlay, the estimate,
    errors and free energy; Lichtblick reads it too.
    """
    from bodylog import views

    from .output import print_result

    return print_result(views.write_viewer_layout(log, out, common.settings()), log, as_json)
