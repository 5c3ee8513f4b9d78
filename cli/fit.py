"""bodylog fit."""

from pathlib import Path

import click

from .options import PATH, Common, common_options, logs_argument, out_option
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
    common: Common,
    as_json: bool,
) -> int:
    """Learn the robot's body from exploration logs: what each sense is expected to read at any joint angles."""
    from bodylog import info, pipeline

    from .output import body, progress, show

    kinematics = {"urdf": urdf, "use": None if no_urdf is None else not no_urdf, "offset_prior": offset_prior}
    chosen = common.settings(
        fit={"preset": preset, "every": every, "without": listed(without)},
        body={"joints": listed(joints)},
        kinematics=kinematics,
    )
    with progress("fit") as tick:
        result = pipeline.fit(logs, out, chosen, tick, update, test)
    learned = info.info(out, chosen)
    code = show(result, as_json, body=learned)
    if not as_json:
        body(learned)
    return code
