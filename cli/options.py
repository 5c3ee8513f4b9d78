"""Options that several commands share, and how they become settings."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from bodylog.settings import Settings

Command = TypeVar("Command", bound=Callable[..., Any])
PATH = click.Path(path_type=Path)


def log_argument(function: Command) -> Command:
    """LOG: any log, .bag, rosbag2 folder, .db3 or .mcap."""
    return click.argument("log", type=PATH)(function)


def logs_argument(function: Command) -> Command:
    """LOG...: one or many logs."""
    return click.argument("logs", metavar="LOG...", type=PATH, nargs=-1, required=True)(function)


def out_option(what: str) -> Callable[[Command], Command]:
    """-o: the file to write."""
    return click.option("-o", "--output", "out", type=PATH, required=True, help=what)


def common_options(function: Command) -> Command:
    """--config, --json."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output."),
        click.option("--config", "config_file", type=PATH, help="A robot.toml with what cannot be guessed."),
    ):
        function = option(function)
    return function


def estimation_options(function: Command) -> Command:
    """How the belief is computed; what is left out comes from robot.toml or the defaults."""
    for option in reversed(ESTIMATION):
        function = option(function)
    return function


ESTIMATION = (
    click.option("--method", help="laplace (default), smoother, predictive-coding or kalman."),
    click.option("--preset", help="paper: the printed model with its constants."),
    click.option("--with", "senses", metavar="SENSES", help="Use just these senses, e.g. encoders,vision,touch."),
    click.option("--without", metavar="SENSES", help="Use all senses but these."),
    click.option("--rate", type=float, metavar="HZ", help="Estimates per second; default: the encoders', at most 100."),
    click.option("--precision", help="auto (default): variances from this log; model: as learned; fixed: the paper's."),
    click.option("--bias", help="Encoder offset states: auto (default), on or off."),
    click.option("--touch", help="likelihood (default) or literal: the paper's two readings of its touch equation."),
    click.option("--step", help="predictive-coding: implicit (default) or explicit Euler."),
)


def settings(config_file: Path | None, **sections: dict[str, Any]) -> "Settings":
    """Settings from robot.toml and what was typed; options not given (None) do not override."""
    from bodylog.config import load

    typed = {name: {k: v for k, v in values.items() if v is not None} for name, values in sections.items()}
    return load(config_file, typed)


def estimation(typed: dict[str, Any]) -> dict[str, Any]:
    """The [estimate] section as typed, comma lists split."""
    lists = {key: tuple(typed[key].split(",")) if typed.get(key) else None for key in ("senses", "without")}
    return {**typed, **lists}
