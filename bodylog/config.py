"""Defaults in code, then robot.toml, then the command line: resolved once, each key checked by name and type."""

import difflib
import math
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from .errors import ConfigError
from .io import toml_file
from .io.toml_file import shown
from .logs.joint_units import counts
from .settings import Estimation, Settings, spell
from .sources import check_colour, parse, spelled


def load(path: Path | None, overrides: Mapping[str, Mapping[str, Any]] | None = None) -> Settings:
    """Settings from a robot.toml (None: defaults), then {section: {key: value}} overrides; ConfigError if unsound."""
    settings = Settings()
    if path is not None:
        settings = merge(settings, toml_file.read(path), str(path))
    return merge(settings, overrides or {}, "command line")


def merge(settings: Settings, given: Mapping[str, Any], where: str) -> Settings:
    """Settings with the given sections' keys replaced; ConfigError names the nearest known key."""
    for section, values in given.items():
        _known(section, [f.name for f in fields(settings)], where, "section", f"[{section}]")
        if not isinstance(values, Mapping):
            raise ConfigError(f"{where}: [{section}] is {values!r}; it must be a table of keys")
        current: Any = getattr(settings, section)
        merged: Any
        if section == "features":
            merged = {**current, **{str(name): parse(str(name), value, where) for name, value in values.items()}}
        else:
            merged = _section(current, section, values, where)
        settings = replace(settings, **{section: merged})
    return settings


def _section(current: Any, section: str, values: Mapping[str, Any], where: str) -> Any:
    hints = typing.get_type_hints(type(current))
    known = {spell(f.name): f.name for f in fields(current)}
    changed = {}
    for key, value in values.items():
        if (section, key) in RENAMED:
            raise ConfigError(f"{where}: {section}.{key} has a new name; type: {RENAMED[section, key]}")
        _known(key, list(known), where, "key", f"{section}.{key}")
        name = known[key]
        changed[name] = _typed(value, hints[name], f"{where}: {section}.{key}")
        _allowed(section, key, changed[name], where)
    if section == "estimate" and changed.get("preset") == "paper" and current.method == Estimation().method:
        changed.setdefault("method", "predictive-coding")  # the printed model is that one
    return replace(current, **changed)


def _known(name: str, known: list[str], where: str, kind: str, label: str) -> None:
    if name not in known:
        near = difflib.get_close_matches(name[:99], known, 1, 0.0)
        raise ConfigError(f"{where}: unknown {kind} {label[:200]}; did you mean {near[0]}? known: {', '.join(known)}")


def _typed(value: Any, hint: Any, what: str) -> Any:
    """The value as the setting's type: lists become tuples, whole numbers become floats where floats are meant."""
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    for option in options:
        fitted = _fit(value, option)
        if fitted is not _MISFIT:
            return fitted
    raise ConfigError(f"{what} is {shown(value)}; it must be {_names(options)}")


_MISFIT = object()


def _fit(value: Any, option: Any) -> Any:
    origin = typing.get_origin(option)
    if option is type(None):
        return None if value is None else _MISFIT
    if origin is tuple:
        return tuple(value) if isinstance(value, list | tuple) and _all_fit(value, option) else _MISFIT
    if origin is not None and issubclass(origin, Mapping):
        return _fit_mapping(value, typing.get_args(option)[1])
    if option is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) if math.isfinite(value) else _MISFIT
    return value if isinstance(value, option) and not (option is int and isinstance(value, bool)) else _MISFIT


def _all_fit(values: Any, option: Any) -> bool:
    wanted = typing.get_args(option)
    kinds = [wanted[0]] * len(values) if wanted[-1] is Ellipsis else wanted
    return len(kinds) == len(values) and all(_fit(v, k) is not _MISFIT for v, k in zip(values, kinds, strict=True))


def _fit_mapping(value: Any, hint: Any) -> Any:
    if not isinstance(value, Mapping):
        return _MISFIT
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    fitted = {k: next((f for o in options if (f := _fit(v, o)) is not _MISFIT), _MISFIT) for k, v in value.items()}
    return _MISFIT if any(v is _MISFIT for v in fitted.values()) else fitted


def _names(options: tuple[Any, ...]) -> str:
    readable = {str: "text", int: "a whole number", float: "a finite number", type(None): "left out"}
    return " or ".join(readable.get(o, "a list" if typing.get_origin(o) is tuple else "a table") for o in options)


RENAMED: Mapping[tuple[str, str], str] = {("colours", "shapes"): "[colours] markers = {NAME = COLOUR}"}
"""Keys that had another name, and what to type."""

ALLOWED: Mapping[tuple[str, str], tuple[str, ...]] = {
    ("body", "unit"): ("rad", "deg", "4096 counts", "4096 counts from 2048"),
    ("time", "joints"): ("auto", "header", "log"),
    ("time", "camera"): ("auto", "header", "log"),
    ("time", "skin"): ("auto", "header", "log"),
    ("time", "truth"): ("auto", "header", "log"),
    ("time", "reference"): ("auto", "header", "log"),
    ("fit", "preset"): ("default", "paper"),
    ("estimate", "preset"): ("default", "paper"),
    ("estimate", "precision"): ("auto", "model", "fixed"),
    ("estimate", "bias"): ("auto", "on", "off"),
    ("estimate", "touch"): ("likelihood", "literal"),
    ("estimate", "step"): ("implicit", "explicit"),
}


LIMITS: Mapping[tuple[str, str], tuple[float, float]] = {
    ("input", "max_image_mpx"): (1e-3, 1e4),
    ("input", "max_message_mb"): (1, 1e5),
    ("input", "max_unpacked_gb"): (1e-3, 1e6),
    ("topics", "rate"): (1e-3, 1e6),
    ("topics", "start"): (-9e9, 9e9),
    ("skin", "threshold"): (0, 1),
    ("skin", "release"): (0, 1),
    ("skin", "shortest"): (0, 3600),
    ("skin", "columns"): (1, 10**6),
    ("estimate", "rate"): (1e-3, 1e4),  # Hz: as the fastest joint controllers; more is a mistake that takes hours
    ("estimate", "start"): (-1e4, 1e4),
    ("estimate", "sigma_encoders"): (1e-18, 1e6),
    ("estimate", "sigma_vision"): (1e-12, 1e12),
    ("estimate", "sigma_touch"): (1e-12, 1e12),
    ("estimate", "process"): (1e-18, 1e9),
    ("estimate", "lambda"): (0, 1e3),
    ("synchrony", "clock_offset"): (-9e9, 9e9),
    ("fit", "samples"): (8, 10**9),
    ("fit", "every"): (1, 10**9),
    ("fit", "seed"): (0, 2**63),
    ("kinematics", "offset_prior"): (0, 180),
    ("kinematics", "scale_prior"): (0, 0.3),  # more is another gear, not a doubt
}
"""Of numbers, the least and the most."""


LATEST = 3600.0
"""s: what a camera dates its pictures late by, at most."""


def _allowed(section: str, key: str, value: Any, where: str) -> None:
    possible = ALLOWED.get((section, key))
    if (section, key) == ("body", "unit") and counts(str(value)) is not None:
        return
    if possible and value not in possible:
        near = difflib.get_close_matches(str(value)[:99], possible, 1, 0.0)
        raise ConfigError(
            f"{where}: {section}.{key} is {shown(value)}; possible: {', '.join(possible)}; did you mean {near[0]}?"
        )
    low, high = LIMITS.get((section, key), (-math.inf, math.inf))
    listed = value.values() if isinstance(value, Mapping) else value if isinstance(value, tuple) else (value,)
    numbers = [one for one in listed if isinstance(one, int | float)]
    if not all(low <= one <= high for one in numbers):
        raise ConfigError(f"{where}: {section}.{key} is {shown(value)}; it must be from {low:g} to {high:g}")
    if (section, key) == ("body", "joints") and value is not None and len(set(value)) < max(len(value), 1):
        raise ConfigError(f"{where}: {section}.{key} is {shown(list(value))}; it must name joints, each once")
    if (section, key) == ("synchrony", "clock_offset") and isinstance(value, str) and value != "auto":
        raise ConfigError(f"{where}: {section}.{key} is {shown(value)}; it must be auto or a number of seconds")
    if (section, key) == ("time", "delay") and isinstance(value, str) and value not in ("auto", "off"):
        raise ConfigError(f"{where}: {section}.{key} is {shown(value)}; it must be auto, off or {{camera = seconds}}")
    late = value.values() if (section, key) == ("time", "delay") and isinstance(value, Mapping) else ()
    if any(abs(seconds) > LATEST for seconds in late):
        raise ConfigError(f"{where}: {section}.{key} is {shown(value)}; it must be at most {LATEST:g} s")
    if section == "topics" and isinstance(value, tuple) and len(set(value)) < max(len(value), 1):
        what = "a topic, or several different ones"
        raise ConfigError(f"{where}: {section}.{key} is {shown(list(value))}; it must be {what}")
    if (section, key) == ("colours", "markers") and (bad := next((name for name in value if "/" in name), None)):
        raise ConfigError(f"{where}: {section}.{key} names {bad!r}; a feature's name has no /, which ends a camera's")
    if section == "colours":
        for colour in value.values() if key == "markers" else [value]:
            if not isinstance(colour, bool):  # of `fast`
                check_colour(colour, f"{where}: {section}.{key}")


def toml(settings: Any) -> str:
    """The settings as a robot.toml; what is None (guessed) is written as a comment."""
    return "\n".join(_toml_section(f.name, getattr(settings, f.name)) for f in fields(settings))


def _toml_section(name: str, section: Any) -> str:
    if isinstance(section, Mapping):
        values = {feature: spelled(source) for feature, source in section.items()}
        return "\n".join([f"[{name}]", *(f"{_toml_key(k)} = {toml_value(v)}" for k, v in values.items()), ""])
    assert is_dataclass(section)
    lines = [_toml_line(spell(f.name), getattr(section, f.name)) for f in fields(section)]
    return "\n".join([f"[{name}]", *lines, ""])


def _toml_line(key: str, value: Any) -> str:
    return f"# {key} = (guessed)" if value is None else f"{key} = {toml_value(value)}"


def _toml_key(key: str) -> str:
    return key if re.fullmatch("[A-Za-z0-9_-]+", key) else toml_value(key)


def toml_value(value: Any) -> str:
    """One value in TOML spelling."""
    import json

    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml_key(k)} = {toml_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    return json.dumps(value, ensure_ascii=False)
