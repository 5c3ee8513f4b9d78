"""batch.toml: groups of logs, each with its body or training logs, methods, settings and bounds."""

import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

from ..config import merge_settings
from ..errors import ConfigError
from ..io import remote, toml_file
from ..io.toml_file import shorten_value
from ..io.toml_keys import check_values, declare_key
from ..settings import METHODS, Settings
from . import Group, folders

LONGEST = 200
"""Characters of a group's name, from which its folder's name is made."""


@dataclass(frozen=True)
class GroupTable:
    """[[group]]: one robot's logs; paths are relative to batch.toml."""

    logs: tuple[str, ...] = declare_key(MISSING, "Logs, folders, patterns or URLs.", noun="log")
    name: str = declare_key(
        "", "Name of the group and of its folder.", noun="name", unset="group1, group2, …"
    )
    train: tuple[str, ...] = declare_key(
        (), "Logs to learn the body from, without body.", noun="log", unset="none"
    )
    body: str | None = declare_key(
        None, "Body model that fit wrote.", noun="file", unset="learned from train"
    )
    methods: tuple[str, ...] = declare_key(
        (), "Methods; each runs as a group of its own.", choices=METHODS, unset="settings' one"
    )
    fail_if: tuple[str, ...] = declare_key(
        (), "Bounds as for --fail-if.", noun="bound", unset="none"
    )
    settings: Mapping[str, Any] = declare_key(
        {}, "Sections of robot.toml for this group.", unset="those of --config"
    )


def load_manifest(path: Path, settings: Settings) -> tuple[Group, ...]:
    """The groups of a manifest, one for each method where
    several are named; ConfigError for an unsound manifest.
    """
    content = toml_file.read_toml(path)
    tables = content.get("group")
    if set(content) != {"group"} or not isinstance(tables, list) or not tables:
        raise ConfigError(
            f"{path}: it must hold [[group]] tables and nothing else; found "
            f"{shorten_value(list(content))}"
        )
    groups = [
        group
        for number, table in enumerate(tables)
        for group in _groups_of_table(path, number, table, settings)
    ]
    names = [group.name for group in groups]
    if len(set(map(folders.fold_case, names))) != len(names):
        raise ConfigError(
            f"{path}: two groups have the same name: {shorten_value(sorted(names))}; give "
            "each a name"
        )
    return tuple(groups)


def _groups_of_table(path: Path, number: int, values: Any, settings: Settings) -> list[Group]:
    where = f"{path}: group {number + 1}"
    if not isinstance(values, Mapping):
        raise ConfigError(f"{where} is {shorten_value(values)}; it must be a [[group]] table")
    table = GroupTable(**check_values(GroupTable, values, where, ""))
    if not table.logs:
        raise ConfigError(f'{where}: logs is empty; type, for example: logs = ["runs/*.mcap"]')
    chosen = merge_settings(settings, table.settings, where)
    methods = table.methods or (chosen.estimate.method,)
    name = table.name or f"group{number + 1}"
    return [
        _build_group(
            path,
            table,
            f"{name}-{method}" if len(methods) > 1 else name,
            merge_settings(chosen, {"estimate": {"method": method}}, where),
        )
        for method in methods
    ]


def _build_group(path: Path, table: GroupTable, name: str, settings: Settings) -> Group:
    base = path.parent
    safe = re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip(".") or "group"
    if len(safe) > LONGEST or folders.fold_case(safe) in folders.TAKEN:
        raise ConfigError(
            f"{path}: a group is called {shorten_value(name)}: too long, or reserved; type "
            "another name"
        )
    return Group(
        name=safe,
        logs=tuple(log if remote.is_url(log) else str(base / log) for log in table.logs),
        settings=settings,
        body=None if table.body is None else base / table.body,
        train=tuple(base / log for log in table.train),
        bounds=table.fail_if,
    )
