"""bodylog fit."""

from pathlib import Path

import click

from .options import PATH, Common, clock_option, common_options, delay_option, listed, logs_argument, out_option


@click.command(epilog="Example: bodylog fit explore.bag -o body.npz")
@logs_argument
@out_option("The body model to write (.npz).")
@click.option("--preset", help="paper: the printed constants and 46 samples.")
@click.option("--joints", help="Learn over these joints, e.g. pan,lift,elbow; default: those that move.")
@click.option("--every", type=click.IntRange(min=1), help="Use every n-th frame.")
@click.option("--without", metavar="TRACKS", help="Leave these tracks out, e.g. published,elbow.")
@click.option("--update", type=PATH, metavar="BODY.npz", help="Learn on from this body model.")
@click.option("--test", type=PATH, multiple=True, metavar="LOG", help="Score the body on this log; may be repeated.")
@click.option("--urdf", metavar="ROBOT.urdf|log", help="Learn with this URDF; default: the log's own, if any.")
@click.option("--no-urdf", is_flag=True, default=None, help="Learn without a URDF.")
@click.option("--offset-prior", type=float, metavar="DEG", help="Expected size of joint offsets; default 5, 0: none.")
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
