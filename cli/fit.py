"""bodylog fit."""

from pathlib import Path

import click

from .options import PATH, Common, all_option, common_options, logs_argument, out_option
from .setting_options import clock_option, delay_option, listed, setting


@click.command(epilog="Example: bodylog fit explore.bag -o body.npz")
@logs_argument
@out_option("The body model to write (.npz).")
@setting("fit", "preset")
@setting("body", "joints", metavar="A,B,...")
@setting("fit", "every")
@setting("fit", "without", metavar="TRACKS")
@click.option("--update", type=PATH, metavar="BODY.npz", help="Learn on from this body model.")
@click.option("--test", type=PATH, multiple=True, metavar="LOG", help="Score the body on this log; may be repeated.")
@setting("kinematics", "urdf", metavar="ROBOT.urdf|log")
@click.option("--no-urdf", is_flag=True, default=None, help="Learn without a URDF.")
@setting("kinematics", "offset_prior", metavar="DEG")
@clock_option
@delay_option
@all_option
@common_options
def fit(
    logs: tuple[Path, ...],
    out: Path,
    preset: str | None,
    joints: str | None,
    every: int | None,
    without: str | None,
    update: Path | None,
    test: tuple[Path, ...],
    urdf: str | None,
    no_urdf: bool | None,
    offset_prior: float | None,
    full: bool,
    common: Common,
    as_json: bool,
) -> int:
    """Learn the robot's body from exploration logs."""
    from bodylog import info, pipeline

    from .body_text import show_body
    from .output import progress, show, verbosity

    kinematics = {"urdf": urdf, "use": None if no_urdf is None else not no_urdf, "offset_prior": offset_prior}
    chosen = common.settings(
        fit={"preset": preset, "every": every, "without": listed(without)},
        body={"joints": listed(joints)},
        kinematics=kinematics,
    )
    with progress("fit", [*logs, *test], chosen) as tick:
        result = pipeline.fit(logs, out, chosen, tick, update, test)
    learned = info.info(out, chosen)
    code = show(result, logs, as_json, full, body=learned)
    if full and not as_json and verbosity() >= 0:
        show_body(learned)
    return code
