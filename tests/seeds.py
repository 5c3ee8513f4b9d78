"""Seeds of tests that repeat one path with other numbers."""

from collections.abc import Iterable

import pytest


def seeds(few: int, many: int) -> list:
    """The first `few` of `many` seeds always, the others in the soak."""
    return first_of(few, range(many))


def first_of(few: int, values: Iterable) -> list:
    """The first `few` of the values always, the others in the soak; tuples are several parameters of one case."""
    values = list(values)
    rest = (value if isinstance(value, tuple) else (value,) for value in values[few:])
    return [*values[:few], *(pytest.param(*value, marks=pytest.mark.soak) for value in rest)]
