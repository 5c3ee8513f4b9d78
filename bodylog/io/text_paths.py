"""Paths given as text: what a library's user types."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

R = TypeVar("R")


def with_text_paths(function: Callable[..., R]) -> Callable[..., R]:
    """The function, which also takes text where a parameter is declared as a path, or as paths.

    Where several paths are possible, a single one stands for a list of one.
    """
    signature = inspect.signature(function)
    declared = {name: str(one.annotation) for name, one in signature.parameters.items()}
    several = {name for name, kind in declared.items() if "Sequence" in kind and "Path" in kind}
    named = {name for name, kind in declared.items() if "Mapping" in kind and "Path" in kind}
    single = {name for name, kind in declared.items() if "Path" in kind} - several - named

    @wraps(function)
    def converting(*args: Any, **kwargs: Any) -> R:
        given = signature.bind(*args, **kwargs)
        for name, value in given.arguments.items():
            if name in single:
                if not isinstance(value, str | Path | None):
                    raise TypeError(
                        f"{function.__name__}: {name} is a {type(value).__name__}; a path is "
                        "expected, as text or pathlib.Path"
                    )
                given.arguments[name] = Path(value) if isinstance(value, str) else value
            elif name in several:
                given.arguments[name] = _as_path_list(value)
            elif name in named and isinstance(value, Mapping):
                given.arguments[name] = {key: Path(path) for key, path in value.items()}
        return function(*given.args, **given.kwargs)

    return converting


def _as_path_list(value: Any) -> Sequence[Path]:
    """One path or several, as a list."""
    each = [value] if isinstance(value, str | Path) else value
    return [Path(one) if isinstance(one, str) else one for one in each]
