"""batch.toml: groups of logs, each with its body or training logs, methods, settings and bounds."""

import difflib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..config import merge
from ..errors import ConfigError
from ..io import remote, toml_file
from ..io.toml_file import shown
from ..settings import Settings
from . import Group, folders

LONGEST = 200
"""Characters of a group's name, of which a folder's is made."""

KEYS: Mapping[str, type[Any]] = {
    "name": str,
    "logs": list,
    "train": list,
    "body": str,
    "methods": list,
    "fail_if": list,
    "settings": dict,
}
"""What a [[group]] may say; paths are relative to the manifest."""


def load(path: Path, settings: Settings) -> tuple[Group, ...]:
    """The groups of a manifest, one for each method where several are named; ConfigError if it makes no sense."""
    said = toml_file.read(path)
    tables = said.get("group")
    if set(said) != {"group"} or not isinstance(tables, list) or not tables:
        raise ConfigError(f"{path}: it must hold [[group]] tables and nothing else; found {shown(list(said))}")
    groups = [group for number, table in enumerate(tables) for group in _groups(path, number, table, settings)]
    names = [group.name for group in groups]
    if len(set(map(folders.folded, names))) != len(names):
        raise ConfigError(f"{path}: two groups are called alike: {shown(sorted(names))}; give each a name")
    return tuple(groups)


def _groups(path: Path, number: int, table: Mapping[str, Any], settings: Settings) -> list[Group]:
    where = f"{path}: group {number + 1}"
    for key, value in table.items():
        _known(where, key, value)
    if not table.get("logs"):
        raise ConfigError(f'{where}: logs is missing; e.g. logs = ["runs/*.mcap"]')
    chosen = merge(settings, table.get("settings", {}), where)
    methods = table.get("methods") or [chosen.estimate.method]
    name = table.get("name", f"group{number + 1}")
    return [
        _group(path, table, f"{name}-{method}" if len(methods) > 1 else name, merge(chosen, _by(method), where))
        for method in methods
    ]


def _by(method: str) -> dict[str, dict[str, str]]:
    return {"estimate": {"method": method}}


def _known(where: str, key: str, value: Any) -> None:
    if key not in KEYS:
        near = difflib.get_close_matches(key[:99], KEYS, 1, 0.0)
        raise ConfigError(f"{where}: unknown key {key[:200]}; did you mean {near[0]}? known: {', '.join(KEYS)}")
    strings = not isinstance(value, list) or all(isinstance(item, str) for item in value)
    if not isinstance(value, KEYS[key]) or not strings:
        raise ConfigError(f"{where}: {key} is {shown(value)}; it must be {_words(KEYS[key])}")
    if "" in (value if isinstance(value, list) else [value]):
        raise ConfigError(f"{where}: {key} is {shown(value)}; a text of it is empty, where a name is expected")


def _words(kind: type[Any]) -> str:
    words: Mapping[type[Any], str] = {str: "text", list: "a list of texts", dict: "a table"}
    return words[kind]


def _group(path: Path, table: Mapping[str, Any], name: str, settings: Settings) -> Group:
    base = path.parent
    safe = re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip(".") or "group"
    if len(safe) > LONGEST or folders.folded(safe) in folders.TAKEN:
        raise ConfigError(f"{path}: a group is called {shown(name)}: too long, or taken; give another name")
    return Group(
        name=safe,
        logs=tuple(log if remote.is_url(log) else str(base / log) for log in table["logs"]),
        settings=settings,
        body=base / table["body"] if "body" in table else None,
        train=tuple(base / log for log in table.get("train", ())),
        bounds=tuple(table.get("fail_if", ())),
    )
