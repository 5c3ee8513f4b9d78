"""bodylog estimate."""

from pathlib import Path
from typing import Any

import click

from . import options
from .setting_options import (
    clock_option,
    delay_option,
    estimation_as_typed,
    estimation_options,
    fast_option,
    setting_option,
)

_URDF = "Without --body: joint limits of this URDF. Default: the log's own, if any."


@click.command(
    epilog="Example: bodylog estimate run.bag --body body.npz -o run.mcap --method smoother"
)
@options.log_argument
@click.option("--body", type=options.PATH, help="What fit wrote; without it, joint sensors alone.")
@setting_option("kinematics", "urdf", metavar="ROBOT.urdf|log", help=_URDF)
@options.out_option("The annotated MCAP to write.")
@options.fail_option
@estimation_options
@fast_option
@clock_option
@delay_option
@options.all_option
@options.common_options
def estimate(
    log: Path,
    body: Path | None,
    urdf: str | None,
    out: Path,
    bounds: tuple[str, ...],
    fast: bool | None,
    full: bool,
    common: options.Common,
    as_json: bool,
    **typed: Any,
) -> int:
    """Estimate angles, error bars and faults of a log.

    The output is the log as an MCAP with the estimate in it. Figures: --all, or evaluate.
    """
    from bodylog import pipeline
    from bodylog.errors import UsageError
    from bodylog.evaluation import bounds as rules

    from .output import print_result, show_progress

    wanted = [rules.parse_bound(text) for text in bounds]
    if urdf is not None and body is not None:
        raise UsageError(
            "--urdf: the body knows its robot; leave --urdf out, or type: bodylog fit LOG "
            "--urdf FILE"
        )
    kinematics = {"urdf": urdf}
    chosen = common.settings(
        colours={"fast": fast}, kinematics=kinematics, estimate=estimation_as_typed(typed)
    )
    with show_progress("estimate", [log], chosen) as tick:
        result = pipeline.estimate(log, body, out, chosen, tick)
    code = print_result(result, log, as_json, full)
    rules.check_bounds({str(log): result.figures}, wanted)
    return code
