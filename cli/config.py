"""bodylog config."""

from pathlib import Path

import click

from .options import PATH


@click.command(epilog="Example: bodylog config > robot.toml")
@click.option("--config", "config_file", type=PATH, help="A robot.toml to resolve.")
@click.option("--json", "as_json", is_flag=True, help="Print them as JSON.")
def config(config_file: Path | None, as_json: bool) -> None:
    """Print every setting as a robot.toml."""
    from bodylog.config import load, toml
    from bodylog.pipeline import Result
    from bodylog.settings import plain

    from .output import entry, print_json

    chosen = load(config_file)
    if as_json:
        print_json([entry(Result(None, settings=plain(chosen)), config_file)])
    else:
        click.echo(toml(chosen), nl=False)
