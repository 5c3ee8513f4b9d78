"""bodylog layout."""

from pathlib import Path

import click

from .options import Common, common_options, log_argument, out_option


@click.command(epilog="Example: bodylog layout run.mcap -o bodylog.json")
@log_argument
@out_option("The layout to write (.json).")
@common_options
def layout(log: Path, out: Path, common: Common, as_json: bool) -> int:
    """A Foxglove or Lichtblick layout for an annotated log: picture with overlay, belief, errors, free energy."""
    from bodylog import views

    from .output import show

    return show(views.layout(log, out, common.settings()), as_json, quiet=True)
