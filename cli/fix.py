"""bodylog fix."""

from pathlib import Path
from typing import Any

import click

from bodylog import choices

from . import options
from .options import Common, OutputLog, common_options
from .setting_options import NearestChoice, setting_option

_REPEATS = "Frames that repeat: mark them in a feature, drop rows to the true rate, or keep."
_EXCLUDE = "Leave out episodes that stand out and copies (accused), or damaged ones alone."
_URDF = "Measure delays by the robot's own surface."


@click.command(epilog="Example: bodylog fix dataset -o corrected")
@click.argument("dataset", metavar="DATASET", type=options.PATH)
@click.option(
    "-o", "--output", "out", type=OutputLog(), required=True, help="The dataset's new folder."
)
@click.option(
    "--repeats",
    type=NearestChoice(choices.REPEATS),
    default="mark",
    show_default=True,
    help=_REPEATS,
)
@click.option(
    "--exclude",
    type=NearestChoice(choices.EXCLUDED),
    default="accused",
    show_default=True,
    help=_EXCLUDE,
)
@click.option(
    "--checked", type=options.PATH, metavar="DIR", help="Rows of doctor -o DIR are used again."
)
@options.jobs_option("Episodes")
@setting_option("kinematics", "urdf", metavar="ROBOT.urdf|log", help=_URDF)
@common_options
def fix(
    dataset: Path,
    out: Path,
    repeats: str,
    exclude: str,
    checked: Path | None,
    workers: int,
    urdf: str | None,
    common: Common,
    as_json: bool,
    **_typed: Any,
) -> int:
    """Write a corrected copy of a LeRobot dataset.

    Images are paired with the rows that they show, by whole frames of the measured delays; episodes
    that stand out are left out and listed in meta/excluded.jsonl. The dataset itself stays as it
    is.
    """
    from bodylog.batch import dataset as examined

    from .batch import print_row
    from .output import print_json, print_line, read_verbosity

    settings = common.settings(kinematics={"urdf": urdf})
    texts = examined.fix_dataset(
        dataset, out, settings, repeats, exclude, workers, checked, print_row
    )
    if as_json:
        result = {"input": str(dataset), "output": str(out), "verdict": list(texts)}
        print_json([result])
        return 0
    for text in texts if read_verbosity() >= 0 else ():
        print_line(text)
    if read_verbosity() >= 0:
        print_line(f"wrote {out}", err=True)
    return 0
