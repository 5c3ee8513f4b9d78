"""Options that several commands share, and how they become settings."""

import functools
import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from .setting_options import setting

if TYPE_CHECKING:
    from bodylog.settings import Settings

Command = TypeVar("Command", bound=Callable[..., Any])


class Named(click.Path):
    """A path that says something: "", which an unset variable leaves, would be the current folder."""

    def __init__(self) -> None:
        """Of a file that need not be there."""
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path."""
        if not os.fspath(value):
            self.fail("a name is expected, and this is empty", param, ctx)
        return Path(value)


class Url(str):
    """A URL whose file is fetched for the time of the command, once its outputs are known to be no inputs."""


class Log(Named):
    """A log: a path, or a URL whose file is fetched before the command begins, or by the command itself if `late`."""

    def __init__(self, late: bool = False) -> None:
        """Fetch before, or leave URLs as they are."""
        super().__init__()
        self._late = late

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path, or the URL."""
        from bodylog.io import remote

        if not isinstance(value, str) or not remote.is_url(value):
            return super().convert(value, param, ctx)
        return value if self._late else Url(value)


class Searched(Named):
    """A log, a pattern, a folder to search or a URL, as it was typed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Text."""
        super().convert(value, param, ctx)
        return value


class OutputFile(Named):
    """A file to write, which may not be there yet."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path."""
        path = super().convert(value, param, ctx)
        if os.fspath(value).endswith(os.sep):
            raise _cannot_be_made(f"{value}: is a folder; give the name of a file")
        return path


class OutputLog(OutputFile):
    """A log to write: a file, or the folder of a dataset, which may not be there yet."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path."""
        text = os.fspath(value)
        return super().convert(text.rstrip(os.sep) or text, param, ctx)


class Folder(Named):
    """A folder to write into, which may not be there yet; refused, before anything is done, where a file is."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path."""
        path = super().convert(value, param, ctx)
        if any(place.exists() and not place.is_dir() for place in (path, *path.parents)):
            raise _cannot_be_made(f"{value}: a file is in its place; give the name of a folder")
        return path


def _cannot_be_made(why: str) -> Exception:
    from bodylog.errors import OutputError

    return OutputError(why)


PATH = Named()
"""A file to read."""
OUT = OutputFile()
FOLDER = Folder()
LOG = Log()
ANYWHERE = Log(late=True)
SEARCHED = Searched()


def finite(_context: click.Context, _option: click.Parameter, value: float | None) -> float | None:
    """An option's number, if it is one."""
    if value is not None and not math.isfinite(value):
        raise click.BadParameter(f"{value} where a finite number is expected")
    return value


def episodic(parameter: str) -> Callable[[Command], Command]:
    """--episode, which names episodes of the datasets in an argument; ranges become several logs."""

    def decorated(function: Command) -> Command:
        @functools.wraps(function)
        def wrapped(*, episode: str | None, **rest: Any) -> Any:
            return function(**{**rest, parameter: _episodes(rest[parameter], episode)})

        help_ = "Read this episode of a dataset; LOG#N means the same."
        return click.option("--episode", metavar="N", callback=_episode, help=help_)(wrapped)  # type: ignore[return-value]

    return decorated


def _episode(_context: click.Context, _option: click.Parameter, text: str | None) -> str | None:
    if text is not None and re.fullmatch(r"\d{1,9}(-\d{1,9})?", text) is None:
        raise click.BadParameter(f"{text!r}; it must be a number, or a range of them, e.g. 3 or 0-9")
    return text


def _episodes(given: Any, text: str | None) -> Any:
    """The logs with the episode that was asked for; of one argument that takes several logs, ranges as single ones."""
    from bodylog.io import episodes

    if isinstance(given, tuple):
        return tuple(one for log in given for one in _several(log, text))
    named = _named(given, text)
    if isinstance(named, Path) and len(episodes.expanded(named)) > 1:
        raise click.BadParameter(f"{named}: this command takes one episode", param_hint="--episode")
    return named


def _named(log: Any, text: str | None) -> Any:
    return log if text is None else type(log)(f"{log}#{text}")


def _several(log: Any, text: str | None) -> tuple[Any, ...]:
    from bodylog.io import episodes

    named = _named(log, text)
    return episodes.expanded(named) if isinstance(named, Path) else (named,)


def log_argument(function: Command) -> Command:
    """LOG: any log, .bag, rosbag2 folder, .db3, .mcap or dataset."""
    return click.argument("log", type=LOG)(episodic("log")(function))


def logs_argument(function: Command) -> Command:
    """LOG...: one or many logs."""
    return click.argument("logs", metavar="LOG...", type=LOG, nargs=-1, required=True)(episodic("logs")(function))


def out_option(what: str) -> Callable[[Command], Command]:
    """-o: the file to write."""
    return click.option("-o", "--output", "out", type=OUT, required=True, help=what)


@dataclass(frozen=True)
class Common:
    """What was typed that every command understands."""

    config_file: Path | None
    strict: bool
    clock_offset: str | None = None
    delay: str | None = None

    def settings(self, **sections: dict[str, Any]) -> "Settings":
        """Settings from robot.toml and what was typed; options not given (None) do not override."""
        from bodylog.config import load

        offset = _seconds(self.clock_offset)
        given: dict[str, dict[str, Any]] = {"input": {"strict": self.strict or None}, **sections}
        given["synchrony"] = {"clock_offset": offset}
        given["time"] = {"delay": _delays(self.delay)}
        typed = {name: {k: v for k, v in values.items() if v is not None} for name, values in given.items()}
        return load(self.config_file, typed)


def _seconds(text: str | None) -> float | str | None:
    try:
        return text if text in (None, "auto") else float(text)
    except ValueError:
        raise click.BadParameter(f"{text!r}; it must be auto or seconds", param_hint="--clock-offset") from None


def _delays(text: str | None) -> dict[str, float] | str | None:
    if text in (None, "auto", "off"):
        return text
    try:
        pairs = (one.rpartition("=") for one in text.split(","))
        return {name or "camera": float(seconds) for name, _, seconds in pairs}
    except ValueError:
        possible = "possible: auto, off, or NAME=S with commas between, e.g. camera=0.05"
        raise click.BadParameter(f"{text!r}; {possible}", param_hint="--delay") from None


def common_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """--config and --strict as `common`, and --json."""

    @functools.wraps(function)
    def wrapped(*, config_file: Path | None, strict: bool, **rest: Any) -> Any:
        clocks = (rest.pop(name, None) for name in ("clock_offset", "delay"))
        return function(common=Common(config_file, strict, *clocks), **rest)

    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output."),
        setting("input", "strict", default=False),
        click.option("--config", "config_file", type=PATH, help="Settings for this robot: a robot.toml."),
    ):
        wrapped = option(wrapped)
    return wrapped


def fail_option(function: Command) -> Command:
    """--fail-if: bounds on scores, faults, delays and what was used."""
    help_ = "E.g. 'rmse/joint>0.02', 'faults>0', 'fault/encoder_offset/*>0.05', 'delay/camera>0.05'; broken: exit 4."
    return click.option("--fail-if", "bounds", multiple=True, metavar="BOUND", help=help_)(function)
