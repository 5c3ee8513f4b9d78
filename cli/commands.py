"""The table of commands."""

from collections.abc import Iterator, Mapping
from functools import cache, partial
from importlib import import_module
from typing import Any

import click

from bodylog import __version__

from .output import VERBOSITY
from .places import guard_command

GROUPS: Mapping[str, Mapping[str, str]] = {
    "Record": {"record": "record", "ingest": "ingest", "convert": "convert"},
    "Look": {
        **{"info": "info", "doctor": "doctor", "features": "features", "colours": "features"},
        **{"plot": "plot", "view": "view"},
    },
    "Learn": {
        "extract": "extract",
        "fit": "fit",
        "calibration": "calibration",
        "offsets": "calibration",
    },
    "Estimate": {"estimate": "estimate", "config": "config"},
    "Judge": {"evaluate": "evaluate", "compare": "compare", "report": "report", "layout": "layout"},
    "Many logs": {"batch": "batch", "fix": "fix", "reproduce": "reproduce"},
}
"""Commands in the order of work, and the module of each."""

_MODULES = {name: module for commands in GROUPS.values() for name, module in commands.items()}


class ByName(Mapping[str, click.Command]):
    """Commands by name; a command's module is imported once the command is needed."""

    def __getitem__(self, name: str) -> click.Command:
        """The command; KeyError for an unknown name."""
        return _load_command(_MODULES[name], name)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names in the order of work."""
        return iter(_MODULES)

    def __len__(self) -> int:
        """The number of commands."""
        return len(_MODULES)


@cache
def _load_command(module: str, name: str) -> click.Command:
    """A command with -q and -v; it starts once its outputs are known to differ from its inputs."""
    command: click.Command = getattr(import_module(f".{module}", __package__), name)
    command.params += [
        _verbosity_option("-q", "--quiet", -1, "Print errors alone."),
        _verbosity_option("-v", "--verbose", 1, "Print all remarks."),
    ]
    if command.callback is not None:
        command.callback = guard_command(command.callback)
    return command


class NoReader(Exception):
    """Standard output has no reader any more."""


class Commands(click.Group):
    """A group that raises NoReader when the reader of
    standard output leaves; click itself would end with 1.

    Without a command it prints its help on standard
    error and ends with 2: click before 8.2 ends with 0.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse what stands before the command."""
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands in the order of work, each with its whole summary."""
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl(
                    [(name, self.commands[name].get_short_help_str(limit=200)) for name in commands]
                )

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was typed."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as err:
            raise NoReader from err


def _verbosity_option(short: str, long: str, level: int, help_: str) -> click.Option:
    """An option that sets how much a command prints."""

    def keep(context: click.Context, _option: click.Parameter, given: bool) -> None:
        if given:
            context.meta[VERBOSITY] = level
            if level < 0:
                import logging

                log = logging.getLogger("bodylog")
                context.call_on_close(partial(log.setLevel, log.level))
                log.setLevel(logging.ERROR)

    return click.Option([short, long], is_flag=True, expose_value=False, callback=keep, help=help_)


@click.group(
    cls=Commands,
    commands=ByName(),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Example: bodylog fit explore.bag -o body.npz && bodylog estimate run.bag --body "
    "body.npz -o run.mcap",
)
@click.version_option(__version__, prog_name="bodylog")
def bodylog() -> None:
    """Where a robot's body was, how sure that is, and which
    sensor is faulty: from any log (.bag, rosbag2, .mcap).
    """
