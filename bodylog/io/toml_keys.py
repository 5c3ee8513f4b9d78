"""Keys of a TOML table, declared as fields of a dataclass:
meaning, values, default, and the check of a value.
"""

import math
import re
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, field, fields
from typing import Any, NamedTuple

from ..errors import ConfigError
from .toml_file import shorten_value


class Key(NamedTuple):
    """The meaning of a key and the values it takes, in one line each.

    `low` and `high` bound its numbers, in `unit`. Texts are one of `choices`; without
    choices, each names a `noun`. A `distinct` list has at least one item and no item
    twice. `unset` describes the default where that is no value. `accepts` replaces the
    check of choices; `form` then says what it accepts.
    """

    meaning: str
    unit: str = ""
    choices: tuple[str, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    noun: str = "text"
    distinct: bool = False
    unset: str = ""
    accepts: Callable[[Any], bool] | None = None
    form: str = ""


class DeclaredKey(NamedTuple):
    """A key of a table: its field's name and type, its description and its default."""

    field: str
    hint: Any
    key: Key
    default: Any


def declare_key(default: Any, meaning: str, **more: Any) -> Any:
    """Declare a dataclass field that is a key of a TOML table; `more` are fields of `Key`."""
    metadata = {"key": Key(meaning, **more)}
    if isinstance(default, dict):
        return field(default_factory=default.copy, metadata=metadata)
    return field(default=default, metadata=metadata)


def spell_key(field_name: str) -> str:
    """A field's key in TOML: a field named like a keyword of Python ends in _."""
    return field_name.rstrip("_")


def declared_keys(table: type) -> Mapping[str, DeclaredKey]:
    """The keys of a table by their names in TOML."""
    hints = typing.get_type_hints(table)
    return {
        spell_key(f.name): DeclaredKey(f.name, hints[f.name], f.metadata["key"], default)
        for f in fields(table)
        for default in [f.default if f.default_factory is MISSING else f.default_factory()]
    }


def check_values(
    table: type, values: Mapping[str, Any], where: str, section: str
) -> dict[str, Any]:
    """The given values by field, as the fields' types;
    ConfigError for an unknown, impossible or missing one.
    """
    known = declared_keys(table)
    found = {}
    for name, value in values.items():
        label = f"{section}.{name}" if section else name
        require_known(name, list(known), where, f"key {label}")
        found[known[name].field] = _check_key_value(known[name], value, f"{where}: {label}")
    required = [name for name, one in known.items() if one.default is MISSING]
    if missing := [name for name in required if name not in values]:
        of = f"{where}: {section}" if section else where
        raise ConfigError(f"{of} has no {missing[0]}; it must have {', '.join(required)}")
    return found


def require_known(name: str, known: list[str], where: str, label: str) -> None:
    """ConfigError that names the nearest known name unless the name is known."""
    if name not in known:
        near = find_nearest_name(name, known)
        raise ConfigError(
            f"{where}: unknown {label[:200]}; did you mean {near}? possible: {', '.join(known)}"
        )


OTHER_NAMES = {"laplace": "filter", "rts": "smoother"}
"""What papers call a method, and its name here: Laplace's approximation; Rauch, Tung, Striebel."""


def find_nearest_name(name: str, known: Sequence[str]) -> str:
    """The known name that means the same, or else the one most like it."""
    import difflib

    if OTHER_NAMES.get(name) in known:
        return OTHER_NAMES[name]
    return difflib.get_close_matches(name[:99], known, 1, 0.0)[0]


def describe_possible_values(about: DeclaredKey) -> str:
    """The values that a key takes, in words."""
    options = [option for option in _type_options(about.hint) if option is not types.NoneType]
    return about.key.form or ", or ".join(
        _describe_type_values(option, about.key) for option in options
    )


def default_text(about: DeclaredKey) -> str:
    """The default of a key, in words or as in TOML."""
    if about.default is MISSING:
        return "required"
    return (
        about.key.unset
        if about.default in (None, "", (), {}) and about.key.unset
        else toml_value(about.default)
    )


def toml_key(name: str) -> str:
    """A key in TOML."""
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else toml_value(name)


def toml_value(value: Any) -> str:
    """A value in TOML."""
    import json

    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{toml_key(k)} = {toml_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    return json.dumps(value, ensure_ascii=False)


_MISFIT = object()


def _check_key_value(about: DeclaredKey, value: Any, label: str) -> Any:
    fitted = _first_fit(value, about.hint)
    if fitted is _MISFIT or not (fitted is None or _is_possible_value(about.key, fitted)):
        raise ConfigError(
            f"{label} is {shorten_value(value)}; possible: "
            f"{describe_possible_values(about)}; {_advise_on_value(about, value)}"
        )
    return fitted


def _advise_on_value(about: DeclaredKey, value: Any) -> str:
    """What to type instead of an impossible value."""
    choices = about.key.choices
    if isinstance(value, str) and choices:
        return f"did you mean {find_nearest_name(value, choices)}?"
    default = default_text(about)
    if about.default is MISSING:
        return "it is required"
    return (
        f"leave it out for: {default}"
        if default == about.key.unset
        else f"type: {spell_key(about.field)} = {default}"
    )


def _is_possible_value(key: Key, value: Any) -> bool:
    """Whether a value of the right type is one that the key takes."""
    items = (
        value.values()
        if isinstance(value, Mapping)
        else value
        if isinstance(value, tuple)
        else (value,)
    )
    numbers = [one for one in items if isinstance(one, int | float)]
    if not all(key.low <= one <= key.high for one in numbers):
        return False
    if key.distinct and isinstance(value, tuple) and len(set(value)) < max(len(value), 1):
        return False
    if key.accepts is not None:
        return key.accepts(value)
    return all(one in key.choices if key.choices else one for one in items if isinstance(one, str))


def _type_options(hint: Any) -> tuple[Any, ...]:
    return typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)


def _first_fit(value: Any, hint: Any) -> Any:
    return next(
        (
            fitted
            for one in _type_options(hint)
            if (fitted := _convert_to_type(value, one)) is not _MISFIT
        ),
        _MISFIT,
    )


def _convert_to_type(value: Any, option: Any) -> Any:
    """The value as the type: lists become tuples,
    whole numbers become floats where floats are meant.
    """
    origin = typing.get_origin(option)
    if option is types.NoneType:
        return None if value is None else _MISFIT
    if origin is tuple:
        return _fit_tuple(value, option)
    if origin is not None and issubclass(origin, Mapping):
        return _fit_mapping(value, typing.get_args(option)[1])
    if option is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) if math.isfinite(value) else _MISFIT
    matches = option is Any or isinstance(value, option)
    return value if matches and not (option is int and isinstance(value, bool)) else _MISFIT


def _fit_tuple(value: Any, option: Any) -> Any:
    if not isinstance(value, list | tuple):
        return _MISFIT
    kinds = typing.get_args(option)
    kinds = (kinds[0],) * len(value) if kinds[-1] is Ellipsis else kinds
    if len(kinds) != len(value):
        return _MISFIT
    fitted = tuple(_convert_to_type(one, kind) for one, kind in zip(value, kinds, strict=True))
    return _MISFIT if _MISFIT in fitted else fitted


def _fit_mapping(value: Any, hint: Any) -> Any:
    if not isinstance(value, Mapping):
        return _MISFIT
    fitted = {name: _first_fit(one, hint) for name, one in value.items()}
    return _MISFIT if any(one is _MISFIT for one in fitted.values()) else fitted


def _describe_type_values(option: Any, key: Key) -> str:
    """Values of one type, in words."""
    origin = typing.get_origin(option)
    if origin is tuple:
        item = (
            f"any of {', '.join(key.choices)}"
            if key.choices
            else _describe_type_values(typing.get_args(option)[0], key)
        )
        return f"[{item}, …]{' without repeats' * key.distinct}"
    if origin is not None:
        value = typing.get_args(option)[1]
        return (
            "table"
            if value is Any
            else f"{{NAME = "
            f"{' or '.join(_describe_type_values(one, key) for one in _type_options(value))}}}"
        )
    if option in (int, float):
        bounds = "" if math.isinf(key.low) else f" from {key.low:g} to {key.high:g}"
        return f"{'whole ' * (option is int)}number{bounds}{' ' * bool(key.unit)}{key.unit}"
    return "true, false" if option is bool else ", ".join(key.choices) or key.noun
