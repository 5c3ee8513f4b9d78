"""Plain values of decoded messages, by message path."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ...io.values import nanoseconds, number, text
from .message_path import Only, Step

Value = int | float | str | bytes
_SECONDS = ("sec", "secs", "seconds")


_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")


def follow(value: Any, steps: tuple[Step, ...], plain: Callable[[Any], Iterator[Any]] | None = None) -> Iterator[Any]:
    """The plain values at the end of the steps, times as ns; KeyError when a field is missing.

    `plain`: splits the final value into plain ones, in place of the default.
    """
    if not steps:
        yield from (plain or _plain)(value)
    elif isinstance(steps[0], str):
        yield from follow(_mapping(value)[steps[0]], steps[1:], plain)
    elif isinstance(steps[0], Only):
        if _mapping(value).get(steps[0].field) == steps[0].value:
            yield from follow(value, steps[1:], plain)
    else:
        for index in steps[0].of(len(_array(value))):
            yield from follow(value[index], steps[1:], plain)


def _mapping(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise KeyError("not an object")
    return value


def _array(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise KeyError("not an array")
    return value


def _plain(value: Any) -> Iterator[Value]:
    if isinstance(value, dict):
        seconds = next(value[key] for key in _SECONDS if key in value) if set(_SECONDS) & value.keys() else None
        if seconds is None:
            raise KeyError("an object, not a value")
        yield nanoseconds(seconds, next((value[key] for key in _NANOSECONDS if key in value), 0))
    elif isinstance(value, list):
        if set(map(type, value)) == {float}:  # most arrays of a robot: nothing to convert
            yield from value
            return
        for item in value:
            yield from _plain(item)
    elif isinstance(value, str | bytes):
        yield text(value) if isinstance(value, str) else value
    else:
        yield float("nan") if value is None else number(value)
