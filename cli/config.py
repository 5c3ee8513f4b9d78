"""bodylog config."""

from pathlib import Path

import click

from .options import PATH


@click.command(epilog="Example: bodylog config > robot.toml")
@click.option("--config", "config_file", type=PATH, help="A robot.toml to resolve.")
def config(config_file: Path | None) -> None:
    """Print every setting as a robot.toml, resolved."""
    from bodylog.config import load, toml

    click.echo(toml(load(config_file)), nl=False)
