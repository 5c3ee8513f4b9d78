"""bodylog evaluate."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .options import PATH, Common, common_options, fail_option, logs_argument

if TYPE_CHECKING:
    from bodylog.pipeline import Result


@click.command(epilog="Example: bodylog evaluate run.mcap --fail-if 'rmse/joint>0.02'")
@logs_argument
@fail_option
@click.option("--truth", type=PATH, metavar="FILE", help="True angles kept elsewhere: .csv, .npz or a log.")
@click.option("--baseline", type=PATH, metavar="RESULTS.jsonl", help="A batch's results to be no worse than.")
@click.option("--tolerance", default="5%", show_default=True, help="By how much an error may grow over the baseline.")
@common_options
def evaluate(
    logs: tuple[Path, ...],
    bounds: tuple[str, ...],
    truth: Path | None,
    baseline: Path | None,
    tolerance: str,
    common: Common,
    as_json: bool,
) -> int:
    """Score annotated logs against the truth they carry, or one kept beside them.

    In a batch's folder the logs are OUT/NAME/annotated.mcap; the baseline is looked up by NAME.
    """
    from bodylog import pipeline
    from bodylog.errors import BoundError
    from bodylog.evaluation import baseline as earlier
    from bodylog.evaluation import bounds as rules

    from .output import as_data, data, each, lost, say

    wanted, share = [rules.parse(text) for text in bounds], earlier.tolerance(tolerance)
    before = earlier.load(baseline) if baseline else None
    chosen = common.settings()
    results, refused = each(logs, lambda log: pipeline.evaluate(log, chosen, truth))
    if as_json:
        shown = [{"path": path, **as_data(result)} for path, result in results.items()]
        data(shown[0] if len(logs) == 1 else shown)
    else:
        _print(results)
    try:
        rules.check({path: result.figures for path, result in results.items()}, wanted)
        if before is not None:
            earlier.check({_name(log): results[str(log)].scores for log in logs if str(log) in results}, before, share)
    except BoundError as broken:
        if not refused:
            raise
        say(broken)
    return refused or max(lost(result.findings) for result in results.values())


def _name(log: Path) -> str:
    return log.parent.name if log.name == "annotated.mcap" else log.name


def _print(results: "dict[str, Result]") -> None:
    from .output import line, table, talk

    for path, result in results.items():
        talk(result.findings, quiet=True)
        line(path)
        table(result.scores)
