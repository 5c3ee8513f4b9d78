"""Options of settings: their choices, bounds, meanings and defaults are those that
bodylog/settings.py declares.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from bodylog.io.toml_keys import default_text, find_nearest_name
from bodylog.settings import find_declaration

if TYPE_CHECKING:
    from bodylog.io.toml_keys import DeclaredKey

    ChoiceType = click.Choice[str]
else:
    ChoiceType = click.Choice
    """Generic in new versions of click only."""

Command = TypeVar("Command", bound=Callable[..., Any])


class NearestChoice(ChoiceType):
    """One of several texts; an error names the nearest."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The text, if it is one of them."""
        if value not in self.choices:
            near = find_nearest_name(str(value), self.choices)
            self.fail(
                f"{value!r}; did you mean {near}? possible: {', '.join(self.choices)}", param, ctx
            )
        return str(value)


def setting_option(
    section: str, key: str, *names: str, **more: Any
) -> Callable[[Command], Command]:
    """The option of a setting; `names` and keywords of
    `click.option` replace those of its declaration.
    """
    found = find_declaration(section, key)
    default = "" if found.hint is bool else f" Default: {default_text(found).strip(chr(34))}."
    names = names or (f"--{key.replace('_', '-')}",)
    return click.option(
        *names, **{"help": found.key.meaning + default, **_option_kind(found), **more}
    )


def _option_kind(found: "DeclaredKey") -> dict[str, Any]:
    if found.hint is bool:
        return {"is_flag": True, "default": None}
    if found.hint is str and found.key.choices:
        return {"type": NearestChoice(found.key.choices)}
    if found.hint is int:
        return {"type": click.IntRange(int(found.key.low), int(found.key.high)), "metavar": "N"}
    return {"type": float} if found.hint in (float, float | None) else {}


def clock_option(function: Command) -> Command:
    """--clock-offset; stands above common_options."""
    return setting_option("synchrony", "clock_offset", metavar="auto|S")(function)


def delay_option(function: Command) -> Command:
    """--delay; stands above common_options."""
    return setting_option("time", "delay", metavar="auto|off|NAME=S")(function)


def fast_option(function: Command) -> Command:
    """--fast."""
    return setting_option("colours", "fast")(function)


def estimation_options(function: Command) -> Command:
    """The options of [estimate]."""
    for option in (
        setting_option("estimate", "step"),
        setting_option("estimate", "touch"),
        setting_option("estimate", "bias"),
        setting_option("estimate", "precision"),
        setting_option("estimate", "rate", metavar="HZ"),
        setting_option("estimate", "without", metavar="SENSES"),
        setting_option("estimate", "senses", "--with", "senses", metavar="SENSES"),
        setting_option("estimate", "preset"),
        setting_option("estimate", "method"),
    ):
        function = option(function)
    return function


def estimation_as_typed(typed: dict[str, Any]) -> dict[str, Any]:
    """The [estimate] section as typed, with comma-separated lists split."""
    return {**typed, **{key: split_list(typed[key]) for key in ("senses", "without")}}


def split_list(text: str | None) -> tuple[str, ...] | None:
    """The items of a comma-separated list; None for an option that was not typed."""
    return None if text is None else tuple(text.split(","))
