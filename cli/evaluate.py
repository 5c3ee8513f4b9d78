"""bodylog evaluate."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .options import common_options, logs_argument, settings

if TYPE_CHECKING:
    from bodylog.pipeline import Result


@click.command(epilog="Example: bodylog evaluate run.mcap --fail-if 'joint_rmse>0.02'")
@logs_argument
@click.option("--fail-if", "bounds", multiple=True, metavar="BOUND", help="E.g. 'joint_rmse>0.02'; broken: exit 4.")
@common_options
def evaluate(logs: tuple[Path, ...], bounds: tuple[str, ...], config_file: Path | None, as_json: bool) -> int:
    """Score annotated logs against the truth they carry."""
    from bodylog import pipeline
    from bodylog.evaluation import bounds as rules

    from .output import as_data, data, lost

    wanted = [rules.parse(text) for text in bounds]
    chosen = settings(config_file)
    results = {str(log): pipeline.evaluate(log, chosen) for log in logs}
    if as_json:
        shown = [{"path": path, **as_data(result)} for path, result in results.items()]
        data(shown[0] if len(shown) == 1 else shown)
    else:
        _print(results)
    rules.check({path: result.scores for path, result in results.items()}, wanted)
    return max(lost(result.findings) for result in results.values())


def _print(results: "dict[str, Result]") -> None:
    from .output import table, talk

    for path, result in results.items():
        talk(result.findings)
        click.echo(path)
        table(result.scores)
