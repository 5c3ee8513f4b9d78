"""bodylog doctor."""

from pathlib import Path

import click

from .options import OUT, PATH, Common, common_options, logs_argument
from .setting_options import delay_option, setting

_URDF = "Calibrate cameras, delays and joint zeros by the robot's own surface, without a marker."


@click.command(epilog="Example: bodylog doctor crashed.mcap --repair sound.mcap")
@logs_argument
@click.option("--repair", type=OUT, metavar="OUT.mcap", help="Write what is sound of one log there.")
@click.option("--body", type=PATH, help="Measure camera delays by this body; default: by one learned from the log.")
@setting("kinematics", "urdf", metavar="ROBOT.urdf|log", help=_URDF)
@delay_option
@common_options
def doctor(
    logs: tuple[Path, ...], repair: Path | None, body: Path | None, urdf: str | None, common: Common, as_json: bool
) -> int:
    """Find what is wrong with a log, and repair it.

    It measures the delay of images relative to the joints in the middle minute of the log; --delay off skips this.
    """
    from bodylog import pipeline

    from .output import each, entry, line, lost, print_json, progress

    if repair is not None and len(logs) != 1:
        raise click.UsageError("--repair takes exactly one LOG")
    settings = common.settings(kinematics={"urdf": urdf})
    with progress("doctor", logs, settings, "messages") as tick:
        results, code = each(logs, lambda log: pipeline.doctor(log, repair, settings, tick, body))
    if as_json:
        print_json([entry(result, path) for path, result in results.items()])
    else:
        for path, result in results.items():
            count = sum(finding.severity != "info" for finding in result.findings)
            line(f"{path}: {'sound' if not count else '1 finding' if count == 1 else f'{count} findings'}")
            for finding in result.findings:
                line(f"  {finding.severity}: {finding.text}")
    return code or max(lost(result.findings) for result in results.values())
