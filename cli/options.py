"""Arguments and options that several commands share, and their settings."""

import functools
import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import click

from .setting_options import setting_option

if TYPE_CHECKING:
    from bodylog.settings import Settings

Command = TypeVar("Command", bound=Callable[..., Any])


class NamedPath(click.Path):
    """A path that is not empty: "", as of an unset shell variable, would be the current folder."""

    def __init__(self) -> None:
        """Accept paths that do not exist."""
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path."""
        if not os.fspath(value):
            self.fail("must not be empty", param, ctx)
        return Path(value)


class FetchedUrl(str):
    """A URL whose file is fetched for the duration of the
    command, after the check that no output is an input.
    """


class LogPath(NamedPath):
    """A log: a path or a URL. Its file is fetched before
    the command starts, or by the command if `late`.
    """

    def __init__(self, late: bool = False) -> None:
        """Leave URLs to the command if `late`."""
        super().__init__()
        self._late = late

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path or the URL."""
        from bodylog.io import remote

        if not isinstance(value, str) or not remote.is_url(value):
            return super().convert(value, param, ctx)
        return value if self._late else FetchedUrl(value)


class Searched(NamedPath):
    """A log, a pattern, a folder to search or a URL, as typed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The text."""
        super().convert(value, param, ctx)
        return value


class OutputFile(NamedPath):
    """A file to write."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path."""
        path = super().convert(value, param, ctx)
        if os.fspath(value).endswith(os.sep):
            raise _cannot_be_made(f"{value}: is a folder; type a file name")
        return path


class OutputLog(OutputFile):
    """A log to write: a file or the folder of a dataset."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path."""
        text = os.fspath(value)
        return super().convert(text.rstrip(os.sep) or text, param, ctx)


class Folder(NamedPath):
    """A folder to write into; an existing file in its place is rejected before anything is done."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path."""
        path = super().convert(value, param, ctx)
        if any(place.exists() and not place.is_dir() for place in (path, *path.parents)):
            raise _cannot_be_made(f"{value}: is a file; type a folder name")
        return path


class PageOrFolder(OutputLog):
    """A page to write (.html), or a folder for it and further files."""

    @staticmethod
    def is_page(path: Path) -> bool:
        """Whether the path names a page."""
        return path.suffix.lower() in (".html", ".htm")


def _cannot_be_made(why: str) -> Exception:
    from bodylog.errors import OutputError

    return OutputError(why)


PATH = NamedPath()
"""A file to read."""
OUT = OutputFile()
FOLDER = Folder()
LOG = LogPath()
ANYWHERE = LogPath(late=True)
SEARCHED = Searched()


def require_finite_option(
    _context: click.Context, _option: click.Parameter, value: float | None
) -> float | None:
    """The number of an option, if it is finite."""
    if value is not None and not math.isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number")
    return value


def episode_option(parameter: str) -> Callable[[Command], Command]:
    """--episode: episodes to read of the datasets in an argument; a range becomes several logs."""

    def decorated(function: Command) -> Command:
        @functools.wraps(function)
        def wrapped(*, episode: str | None, **rest: Any) -> Any:
            return function(**{**rest, parameter: _with_episodes(rest[parameter], episode)})

        help_ = "Read this episode of a dataset; LOG#N means the same."
        return click.option("--episode", metavar="N", callback=_check_episode_option, help=help_)(
            wrapped
        )  # type: ignore[return-value]

    return decorated


def _parse_episode_range(
    _context: click.Context, _option: click.Parameter, text: str | None
) -> tuple[int | None, int | None] | None:
    """First and the one after the last, as in Python's slices."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d{0,9}):(\d{0,9})", text)
    if not found:
        raise click.BadParameter(f"{text!r}; it must be FIRST:END, without END, e.g. 0:50")
    return (int(found[1]) if found[1] else None, int(found[2]) if found[2] else None)


def episodes_option(function: Command) -> Command:
    """--episodes: the part of a dataset that is read."""
    return click.option(
        "--episodes",
        callback=_parse_episode_range,
        metavar="A:B",
        help="Of a dataset: from A to before B.",
    )(function)


def _check_episode_option(
    _context: click.Context, _option: click.Parameter, text: str | None
) -> str | None:
    if text is not None and re.fullmatch(r"\d{1,9}(-\d{1,9})?", text) is None:
        raise click.BadParameter(f"{text!r}; possible: a number or a range, e.g. 3 or 0-9")
    return text


def _with_episodes(given: Any, text: str | None) -> Any:
    """The given log or logs with the episode; where several
    logs are possible, a range becomes one log per episode.
    """
    from bodylog.io import episodes

    if isinstance(given, tuple):
        return tuple(one for log in given for one in _list_episode_paths(log, text))
    named = _name_episode(given, text)
    if isinstance(named, Path) and len(episodes.expand_episode_range(named)) > 1:
        raise click.BadParameter(f"{named}: this command takes one episode", param_hint="--episode")
    return named


def _name_episode(log: Any, text: str | None) -> Any:
    return log if text is None else type(log)(f"{log}#{text}")


def _list_episode_paths(log: Any, text: str | None) -> tuple[Any, ...]:
    from bodylog.io import episodes

    named = _name_episode(log, text)
    return episodes.expand_episode_range(named) if isinstance(named, Path) else (named,)


def log_argument(function: Command) -> Command:
    """LOG: any log, .bag, rosbag2 folder, .db3, .mcap or dataset."""
    return click.argument("log", type=LOG)(episode_option("log")(function))


def logs_argument(function: Command) -> Command:
    """LOG...: one or many logs."""
    return click.argument("logs", metavar="LOG...", type=LOG, nargs=-1, required=True)(
        episode_option("logs")(function)
    )


def out_option(what: str) -> Callable[[Command], Command]:
    """-o: the file to write."""
    return click.option("-o", "--output", "out", type=OUT, required=True, help=what)


class Common(NamedTuple):
    """The options that every command has, as typed."""

    config_file: Path | None
    strict: bool
    clock_offset: str | None = None
    delay: str | None = None

    def settings(self, **sections: dict[str, Any]) -> "Settings":
        """Settings from robot.toml and the typed options; None does not override."""
        from bodylog.config import load_settings

        offset = _parse_seconds(self.clock_offset)
        given: dict[str, dict[str, Any]] = {"input": {"strict": self.strict or None}, **sections}
        given["synchrony"] = {"clock_offset": offset}
        given["time"] = {"delay": _parse_delays(self.delay)}
        typed = {
            name: {k: v for k, v in values.items() if v is not None}
            for name, values in given.items()
        }
        return load_settings(
            self.config_file, {name: values for name, values in typed.items() if values}
        )


def _parse_seconds(text: str | None) -> float | str | None:
    try:
        return text if text in (None, "auto") else float(text)
    except ValueError:
        raise click.BadParameter(
            f"{text!r}; possible: auto, or seconds", param_hint="--clock-offset"
        ) from None


def _parse_delays(text: str | None) -> dict[str, float] | str | None:
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
        click.option(
            "--json", "as_json", is_flag=True, help="Print the result as JSON on standard output."
        ),
        setting_option("input", "strict", default=False),
        click.option(
            "--config", "config_file", type=PATH, help="Settings for this robot: a robot.toml."
        ),
    ):
        wrapped = option(wrapped)
    return wrapped


def fail_option(function: Command) -> Command:
    """--fail-if: bounds on scores, faults, delays and used readings."""
    help_ = (
        "E.g. 'rmse/joint>0.02', 'faults>0', 'fault/encoder_offset/*>0.05', 'delay/camera>0.05'; "
        "broken: exit 4."
    )
    return click.option("--fail-if", "bounds", multiple=True, metavar="BOUND", help=help_)(function)


def all_option(function: Command) -> Command:
    """--all: every score, below the verdict."""
    return click.option("--all", "full", is_flag=True, help="Print every score with its unit too.")(
        function
    )


def window_options(function: Command) -> Command:
    """Options start and end: which part of a log (s since its start)."""
    add_end = click.option(
        "--end",
        type=float,
        callback=require_finite_option,
        metavar="S",
        help="Leave out what came after.",
    )
    add_start = click.option(
        "--start",
        type=float,
        callback=require_finite_option,
        metavar="S",
        help="Leave out what came before (s since start).",
    )
    return add_start(add_end(function))


def jobs_option(items: str) -> Callable[[Command], Command]:
    """Option workers: how many `items`, as Logs, are worked on at a time."""
    return click.option(
        "--jobs",
        "workers",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        help=f"{items} at a time.",
    )


def share_options(item: str) -> Callable[[Command], Command]:
    """Options scheduler, shard and resume: who works on which `item`, as log."""

    def add_options(function: Command) -> Command:
        again = "Skip what an earlier run did with the same input, settings and version."
        function = click.option("--resume", is_flag=True, help=again)(function)
        part = f"Every N-th {item}, from the I-th."
        function = click.option(
            "--shard", metavar="I/N", default="1/1", show_default=True, help=part
        )(function)
        who = "A Dask scheduler, tcp://HOST:PORT, or local."
        return click.option("--scheduler", metavar="ADDRESS", help=who)(function)

    return add_options
