"""Inputs and outputs of a command, by its options: no
output may be an input; URLs are fetched after that check.
"""

import functools
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import FetchedUrl, Folder, NamedPath, OutputFile, OutputLog
from .output import COPIES

if TYPE_CHECKING:
    from bodylog.io.outputs import Output


def guard_command(command: Callable[..., Any]) -> Callable[..., Any]:
    """Reject a command before it reads anything if an output is an input or cannot be written."""

    @functools.wraps(command)
    def checked(**given: Any) -> Any:
        ctx = click.get_current_context()
        outputs = list(_iterate_outputs(ctx.command.params, given))
        if outputs:
            from bodylog.io.atomic_files import require_writable
            from bodylog.io.outputs import guard_outputs

            guard_outputs(_iterate_inputs(ctx.command.params, given), outputs)
            for output in outputs:
                require_writable(output.path, output.folder)
        # A context of click 8.1 does not tell what it holds
        # how the command ended; messages then name the copies.
        with ExitStack() as fetched:
            patience = _read_max_wait_s(given)
            return command(
                **{name: _fetch_logs(value, fetched, patience) for name, value in given.items()}
            )

    return checked


def _iterate_outputs(params: list[click.Parameter], given: dict[str, Any]) -> "Iterator[Output]":
    for param in params:
        if isinstance(param.type, OutputFile | Folder):
            from bodylog.io.outputs import Output

            for path in _iterate_values(given[param.name or ""]):
                folder = isinstance(param.type, Folder) or (
                    isinstance(param.type, OutputLog) and path.is_dir()
                )
                yield Output(path, param.opts[0], folder)


def _iterate_inputs(params: list[click.Parameter], given: dict[str, Any]) -> Iterator[Path]:
    """Every path that an option names apart from outputs; of file:// URLs the file.

    The folders that a batch searches are no inputs;
    the logs found in them are, which it says itself.
    """
    from bodylog.io import remote

    for param in params:
        if isinstance(param.type, NamedPath) and not isinstance(param.type, OutputFile | Folder):
            for value in _iterate_values(given[param.name or ""]):
                path = (
                    remote.file_behind(value)
                    if isinstance(value, str) and remote.is_url(value)
                    else Path(value)
                )
                if path is not None and not (isinstance(value, str) and path.is_dir()):
                    yield path


def _iterate_values(value: Any) -> Iterator[Any]:
    """One value, several, or none."""
    if value is not None:
        yield from value if isinstance(value, tuple) else (value,)


def _read_max_wait_s(given: dict[str, Any]) -> float:
    """How long to wait for a server, s: what the settings
    say, which are read only where a URL is named.
    """
    if not any(
        isinstance(one, FetchedUrl) for value in given.values() for one in _iterate_values(value)
    ):
        return 0.0
    from bodylog.config import load_settings

    return load_settings(given.get("config_file")).input.max_wait_s


def _fetch_logs(value: Any, fetched: ExitStack, wait_s: float) -> Any:
    """Logs behind URLs as files that last as long as the command."""
    if isinstance(value, tuple):
        return tuple(_fetch_logs(one, fetched, wait_s) for one in value)
    if not isinstance(value, FetchedUrl):
        return value
    from tempfile import gettempdir

    from bodylog.io import remote

    path = fetched.enter_context(remote.local_copy(value, Path(gettempdir()), wait_s))
    click.get_current_context().meta.setdefault(COPIES, {})[str(path)] = str(value)
    return path
