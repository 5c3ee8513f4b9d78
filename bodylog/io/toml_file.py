"""Read TOML files of people as plain values, with limits on length, depth and number size."""

import re
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from .atomic_files import read_limited_text

MOST_BYTES = 4 << 20
DEEPEST = 32
"""Parts of a key, and levels of tables and lists: each takes memory before it can be checked."""
LARGEST = 2**63 - 1

_TOKEN = re.compile(r"""(?s)[A-Za-z0-9_-]++|"(?:[^"\\\n]|\\.)*+"?|'[^'\n]*+'?|\.|[ \t]++|.""")


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file or pipe; ConfigError
    if it is unreadable, invalid or beyond the limits.
    """
    import tomllib

    try:
        content = read_limited_text(path, MOST_BYTES)
    except (OSError, UnicodeDecodeError) as err:
        why = err.strerror if isinstance(err, OSError) else err
        raise ConfigError(
            f"{path}: cannot be read as TOML ({why}); give a file like that of: bodylog config"
        ) from err
    if _longest_key(content) > DEEPEST:
        raise ConfigError(
            f"{path}: not TOML of bodylog's: a key has more than {DEEPEST} parts with dots between"
        )
    try:
        found = tomllib.loads(content)
    except RecursionError:
        raise ConfigError(
            f"{path}: cannot be read as TOML: its tables or lists are too deep"
        ) from None
    except ValueError as err:  # covers TOMLDecodeError and numbers of too many digits
        raise ConfigError(f"{path}: cannot be read as TOML: {err}") from err
    _check_toml_value(found, str(path), 0)
    return found


def _longest_key(content: str) -> int:
    """An upper bound of the parts of the longest dotted key: it counts strings and comments too."""
    longest = 0
    parts = 0
    dotted = False
    for found in _TOKEN.finditer(content):
        token = found[0]
        if token[0] in " \t":
            continue
        if token == ".":
            dotted = parts > 0
        elif token[0] in "\"'" or token[0] in "-_" or token[0].isalnum():
            parts = parts + 1 if dotted else 1
            longest = max(longest, parts)
            dotted = False
        else:
            parts = 0
            dotted = False
    return longest


def _check_toml_value(value: Any, where: str, depth: int) -> None:
    if depth > DEEPEST:
        raise ConfigError(f"{where}: tables and lists are more than {DEEPEST} deep")
    if isinstance(value, dict):
        for key, inner in value.items():
            _check_toml_value(key, where, depth)
            _check_toml_value(inner, where, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _check_toml_value(inner, where, depth + 1)
    elif isinstance(value, str) and "\0" in value:
        raise ConfigError(f"{where}: {value[:40]!r} holds the character 0, which no name can")
    elif isinstance(value, int) and abs(value) > LARGEST:
        raise ConfigError(f"{where}: a whole number is beyond 64 bits")


def shorten_value(value: Any) -> str:
    """A value for a message, shortened if long."""
    text = repr(value)
    return text if len(text) <= 200 else f"{text[:200]}…"
