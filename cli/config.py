"""bodylog config."""

from pathlib import Path

import click

from .options import PATH


@click.command(epilog="Example: bodylog config > robot.toml")
@click.option("--config", "config_file", type=PATH, help="A robot.toml to resolve.")
@click.option("--json", "as_json", is_flag=True, help="Print them as JSON.")
def config(config_file: Path | None, as_json: bool) -> None:
    """Print every setting as a robot.toml."""
    from bodylog.config import load_settings, settings_as_toml
    from bodylog.pipeline import Result
    from bodylog.settings import settings_as_values

    from .output import print_json, result_entry

    chosen = load_settings(config_file)
    if as_json:
        print_json([result_entry(Result(None, settings=settings_as_values(chosen)), config_file)])
    else:
        click.echo(settings_as_toml(chosen), nl=False)
