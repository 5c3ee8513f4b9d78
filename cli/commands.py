"""The table of commands."""

from typing import Any

import click

from bodylog import __version__

from . import (
    batch,
    compare,
    config,
    convert,
    doctor,
    estimate,
    evaluate,
    extract,
    features,
    fit,
    info,
    ingest,
    layout,
    offsets,
    plot,
    record,
    report,
    reproduce,
    view,
)
from .places import guarded

COMMANDS = (
    record.record,
    ingest.ingest,
    convert.convert,
    info.info,
    doctor.doctor,
    features.features,
    features.colours,
    extract.extract,
    fit.fit,
    estimate.estimate,
    evaluate.evaluate,
    compare.compare,
    plot.plot,
    report.report,
    layout.layout,
    offsets.offsets,
    view.view,
    batch.batch,
    reproduce.reproduce,
    config.config,
)


class Unheard(Exception):
    """Nobody reads standard output any more."""


class Commands(click.Group):
    """A group that raises Unheard when the reader of standard output leaves; click itself would end with 1.

    Without a command it prints its help on standard error and ends with 2: click before 8.2 ends with 0.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse what stands before the command."""
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """A further command, which does not begin before its outputs are known to be no inputs."""
        if cmd.callback is not None:
            cmd.callback = guarded(cmd.callback)
        super().add_command(cmd, name)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was typed."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as err:
            raise Unheard from err


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Example: bodylog fit explore.bag -o body.npz && bodylog estimate run.bag --body body.npz -o run.mcap",
)
@click.version_option(__version__, prog_name="bodylog")
def bodylog() -> None:
    """Where was the robot's body, how sure is that, and which sensor lied: from any log (.bag, rosbag2, .mcap)."""


for _command in COMMANDS:
    bodylog.add_command(_command)
