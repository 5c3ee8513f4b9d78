"""Plain values of decoded messages, by message path."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ...io.values import encodable_text, number_in_64_bits, stamp_ns
from .message_path import Only, Step

Value = int | float | str | bytes
_SECONDS = ("sec", "secs", "seconds")


_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")


def follow_steps(
    value: Any, steps: tuple[Step, ...], plain: Callable[[Any], Iterator[Any]] | None = None
) -> Iterator[Any]:
    """The plain values at the end of the steps, times as ns; KeyError when a field is missing.

    `plain`: splits the final value into plain ones, in place of the default.
    """
    if not steps:
        yield from (plain or _plain_values)(value)
    elif isinstance(steps[0], str):
        yield from follow_steps(_plain_mapping(value)[steps[0]], steps[1:], plain)
    elif isinstance(steps[0], Only):
        if _plain_mapping(value).get(steps[0].field) == steps[0].value:
            yield from follow_steps(value, steps[1:], plain)
    else:
        for index in steps[0].of(len(_as_array(value))):
            yield from follow_steps(value[index], steps[1:], plain)


def _plain_mapping(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise KeyError("not an object")
    return value


def _as_array(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise KeyError("not an array")
    return value


def _plain_values(value: Any) -> Iterator[Value]:
    if isinstance(value, dict):
        seconds = (
            next(value[key] for key in _SECONDS if key in value)
            if set(_SECONDS) & value.keys()
            else None
        )
        if seconds is None:
            raise KeyError("an object, not a value")
        yield stamp_ns(seconds, next((value[key] for key in _NANOSECONDS if key in value), 0))
    elif isinstance(value, list):
        if set(map(type, value)) == {float}:  # most arrays of a robot: nothing to convert
            yield from value
            return
        for item in value:
            yield from _plain_values(item)
    elif isinstance(value, str | bytes):
        yield encodable_text(value) if isinstance(value, str) else value
    else:
        yield float("nan") if value is None else number_in_64_bits(value)
