"""Write docs/cli.md from every command's --help; a test compares them."""

from pathlib import Path

import click
from bodylog_cli.commands import bodylog

PAGE = Path(__file__).with_name("cli.md")


def page() -> str:
    """The command line reference as Markdown."""
    parts = ["# Command line\n\nEvery `--help`, word for word.\n", _help("bodylog", bodylog)]
    parts += [_help(f"bodylog {name}", command) for name, command in bodylog.commands.items()]
    return "\n".join(parts)


def _help(name: str, command: click.Command) -> str:
    context = click.Context(command, info_name=name, terminal_width=100, help_option_names=["-h", "--help"])
    return f"## {name}\n\n```text\n{command.get_help(context)}\n```\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
