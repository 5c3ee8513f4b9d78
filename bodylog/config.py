"""Defaults in code, then robot.toml, then the command line:
resolved once, each key checked against its declaration.
"""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from .errors import ConfigError
from .io import toml_file
from .io.text_paths import with_text_paths
from .io.toml_file import shorten_value
from .io.toml_keys import (
    check_values,
    declared_keys,
    default_text,
    describe_possible_values,
    require_known,
    toml_key,
    toml_value,
)
from .settings import EstimationSettings, Settings
from .sources import parse_source, source_as_value


@with_text_paths
def load_settings(
    path: Path | None = None, overrides: Mapping[str, Mapping[str, Any]] | None = None
) -> Settings:
    """Settings from a robot.toml (None: defaults), then
    {section: {key: value}} overrides; ConfigError if unsound.
    """
    settings = Settings()
    if path is not None:
        settings = merge_settings(settings, toml_file.read_toml(path), str(path))
    return merge_settings(settings, overrides or {}, "command line")


def merge_settings(settings: Settings, given: Mapping[str, Any], where: str) -> Settings:
    """Settings with the given sections' keys replaced;
    ConfigError for an unknown key or an impossible value.
    """
    for section, values in given.items():
        require_known(section, [f.name for f in fields(settings)], where, f"section [{section}]")
        if not isinstance(values, Mapping):
            raise ConfigError(
                f"{where}: [{section}] is {shorten_value(values)}; it must be a table of keys"
            )
        current: Any = getattr(settings, section)
        merged: Any
        if section == "features":
            merged = {
                **current,
                **{
                    str(name): parse_source(str(name), value, where)
                    for name, value in values.items()
                },
            }
        else:
            merged = _merge_section(current, section, values, where)
        settings = replace(settings, **{section: merged})
    return settings


def _merge_section(current: Any, section: str, values: Mapping[str, Any], where: str) -> Any:
    changed = check_values(type(current), values, where, section)
    if (
        section == "estimate"
        and changed.get("preset") == "paper"
        and current.method == EstimationSettings().method
    ):
        changed.setdefault("method", "predictive-coding")  # the printed model is that one
    return replace(current, **changed)


def settings_as_toml(settings: Settings) -> str:
    """The settings as a robot.toml: each key below its
    meaning, values and default; unset keys are comments.
    """
    return "\n".join(_section_lines(f.name, getattr(settings, f.name)) for f in fields(settings))


def _section_lines(name: str, section: Any) -> str:
    if isinstance(section, Mapping):
        head = [
            "# Tracks, each from a colour, tag, board, point, topic or table: docs/settings.md",
            "[features]",
        ]
        return "\n".join(
            [
                *head,
                *(f"{toml_key(k)} = {toml_value(source_as_value(v))}" for k, v in section.items()),
                "",
            ]
        )
    lines = [f"[{name}]"]
    for key, one in declared_keys(type(section)).items():
        value = getattr(section, one.field)
        lines += [
            f"# {one.key.meaning}",
            f"#   {describe_possible_values(one)}; default: {default_text(one)}",
        ]
        lines.append(f"# {key} =" if value is None else f"{key} = {toml_value(value)}")
    return "\n".join([*lines, ""])
