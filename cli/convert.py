"""bodylog convert."""

from functools import partial
from pathlib import Path

import click

from bodylog import choices

from .options import Common, OutputLog, common_options, logs_argument, window_options
from .setting_options import NearestChoice, split_list


@click.command(
    epilog="Example: bodylog convert run.bag -o dataset --to lerobot --task 'fold the cloth'"
)
@logs_argument
@click.option(
    "-o",
    "--output",
    "out",
    type=OutputLog(),
    required=True,
    help="The MCAP, or the dataset's new folder.",
)
@click.option(
    "--to",
    "form",
    type=NearestChoice(choices.FORMATS),
    default="mcap",
    show_default=True,
    help="Format.",
)
@click.option(
    "--codec",
    "how",
    type=NearestChoice(choices.VIDEO_CODECS),
    default="lossless",
    show_default=True,
)
@click.option("--task", metavar="TEXT", help="What the robot does, for a dataset.")
@click.option("--topics", metavar="TOPICS", help="Only these, with commas between; for an MCAP.")
@window_options
@common_options
def convert(
    logs: tuple[Path, ...],
    out: Path,
    form: str,
    how: str,
    task: str | None,
    topics: str | None,
    start: float | None,
    end: float | None,
    common: Common,
    as_json: bool,
) -> int:
    """Write logs as an MCAP or a LeRobot dataset.

    An MCAP takes one log; a dataset takes several as its episodes.
    """
    from bodylog import info, pipeline

    from .output import print_result, show_progress

    settings = common.settings()
    window = {"start": start, "end": end}
    whole = start is None and end is None
    images = partial(info.dataset_images, settings=settings) if whole else lambda _: 0
    unit, count = ("messages", None) if form == "mcap" else ("images", images)
    with show_progress("convert", logs, settings, unit, count) as tick:
        result = pipeline.convert(
            logs, out, settings, form, how, split_list(topics), task, tick, **window
        )
    return print_result(result, logs, as_json)
