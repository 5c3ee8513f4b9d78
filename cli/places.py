"""Inputs and outputs of a command, by its options: no output may be an input; URLs are fetched after that check."""

import functools
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import Folder, Named, OutputFile, OutputLog, Url
from .output import COPIES

if TYPE_CHECKING:
    from bodylog.io.outputs import Output


def guarded(command: Callable[..., Any]) -> Callable[..., Any]:
    """Reject the command before it reads anything where an output is an input or cannot be written."""

    @functools.wraps(command)
    def checked(**given: Any) -> Any:
        ctx = click.get_current_context()
        outputs = list(_outputs(ctx.command.params, given))
        if outputs:
            from bodylog.io.atomic_files import writable
            from bodylog.io.outputs import guard

            guard(_inputs(ctx.command.params, given), outputs)
            for output in outputs:
                writable(output.path, output.folder)
        # A context of click 8.1 does not tell what it holds how the command ended; messages then name the copies.
        with ExitStack() as fetched:
            patience = _patience(given)
            return command(**{name: _fetched(value, fetched, patience) for name, value in given.items()})

    return checked


def _outputs(params: list[click.Parameter], given: dict[str, Any]) -> "Iterator[Output]":
    for param in params:
        if isinstance(param.type, OutputFile | Folder):
            from bodylog.io.outputs import Output

            for path in _each(given[param.name or ""]):
                folder = isinstance(param.type, Folder) or (isinstance(param.type, OutputLog) and path.is_dir())
                yield Output(path, param.opts[0], folder)


def _inputs(params: list[click.Parameter], given: dict[str, Any]) -> Iterator[Path]:
    """Every path that an option names apart from outputs; of file:// URLs the file.

    The folders that a batch searches are no inputs; the logs found in them are, which it says itself.
    """
    from bodylog.io import remote

    for param in params:
        if isinstance(param.type, Named) and not isinstance(param.type, OutputFile | Folder):
            for value in _each(given[param.name or ""]):
                path = remote.file_behind(value) if isinstance(value, str) and remote.is_url(value) else Path(value)
                if path is not None and not (isinstance(value, str) and path.is_dir()):
                    yield path


def _each(value: Any) -> Iterator[Any]:
    """One value, several, or none."""
    if value is not None:
        yield from value if isinstance(value, tuple) else (value,)


def _patience(given: dict[str, Any]) -> float:
    """How long to wait for a server, s: what the settings say, which are read only where a URL is named."""
    if not any(isinstance(one, Url) for value in given.values() for one in _each(value)):
        return 0.0
    from bodylog.config import load

    return load(given.get("config_file")).input.max_wait_s


def _fetched(value: Any, fetched: ExitStack, wait_s: float) -> Any:
    """Logs behind URLs as files that last as long as the command."""
    if isinstance(value, tuple):
        return tuple(_fetched(one, fetched, wait_s) for one in value)
    if not isinstance(value, Url):
        return value
    from tempfile import gettempdir

    from bodylog.io import remote

    path = fetched.enter_context(remote.local(value, Path(gettempdir()), wait_s))
    click.get_current_context().meta.setdefault(COPIES, {})[str(path)] = str(value)
    return path
