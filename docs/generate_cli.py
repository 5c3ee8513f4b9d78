"""Write docs/cli.md from every command's --help; a test compares them."""

from pathlib import Path

import click
from bodylog_cli.commands import bodylog

PAGE = Path(__file__).with_name("cli.md")
BEGIN = """# Command line

An output file is complete or absent: it is written under another name and then renamed. A symlink's target is replaced.
No output may be an input, lie inside one or, as a folder, contain one; such commands are rejected before anything is
read. `--config` and `--baseline` may be pipes: `--config <(sed s/left/right/ robot.toml)`.

This page is the output of every `--help`.
"""


def page() -> str:
    """The command line reference as Markdown."""
    parts = [BEGIN, _help("bodylog", bodylog)]
    parts += [_help(f"bodylog {name}", command) for name, command in bodylog.commands.items()]
    return "\n".join(parts)


def _help(name: str, command: click.Command) -> str:
    context = click.Context(command, info_name=name, terminal_width=100, help_option_names=["-h", "--help"])
    return f"## {name}\n\n```text\n{command.get_help(context)}\n```\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
