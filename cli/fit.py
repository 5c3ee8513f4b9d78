"""bodylog fit."""

from pathlib import Path

import click

from .options import (
    PATH,
    Common,
    all_option,
    common_options,
    episodes_option,
    logs_argument,
    out_option,
)
from .setting_options import clock_option, delay_option, setting_option, split_list


@click.command(epilog="Example: bodylog fit explore.bag -o body.npz")
@logs_argument
@out_option("The body model to write (.npz).")
@episodes_option
@setting_option("fit", "preset")
@setting_option("body", "joints", metavar="A,B,...")
@setting_option("fit", "every")
@setting_option("fit", "without", metavar="TRACKS")
@click.option("--update", type=PATH, metavar="BODY.npz", help="Learn on from this body model.")
@click.option(
    "--test",
    type=PATH,
    multiple=True,
    metavar="LOG",
    help="Score the body on this log; may be repeated.",
)
@setting_option("kinematics", "urdf", metavar="ROBOT.urdf|log")
@click.option("--no-urdf", is_flag=True, default=None, help="Learn without a URDF.")
@setting_option("kinematics", "offset_prior", metavar="DEG")
@clock_option
@delay_option
@all_option
@common_options
def fit(
    logs: tuple[Path, ...],
    out: Path,
    episodes: tuple[int | None, int | None] | None,
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
    """Learn the robot's body from exploration logs.

    Of a dataset, or a folder of logs, all episodes are learned from together; those that teach
    nothing are left out by name.
    """
    from bodylog import info, pipeline
    from bodylog.batch import dataset

    from .body_text import show_body
    from .output import print_result, read_verbosity, show_progress

    kinematics = {
        "urdf": urdf,
        "use": None if no_urdf is None else not no_urdf,
        "offset_prior": offset_prior,
    }
    chosen = common.settings(
        fit={"preset": preset, "every": every, "without": split_list(without)},
        body={"joints": split_list(joints)},
        kinematics=kinematics,
    )
    several = any(map(dataset.holds_several_logs, logs))
    if episodes is not None and not several:
        raise click.UsageError("--episodes is for a dataset or a folder of logs")
    if several:
        begin, end = episodes or (None, None)
        logs = tuple(map(Path, dataset.chosen_episodes(logs, begin, end)))
    with show_progress("fit", [*logs, *test], chosen) as tick:
        result = pipeline.fit(logs, out, chosen, tick, update, test, leave_out=several)
    learned = info.describe_file(out, chosen)
    code = print_result(result, logs, as_json, full, body=learned)
    if full and not as_json and read_verbosity() >= 0:
        show_body(learned)
    return code
