"""Seeds of tests that repeat one path with other numbers."""

import pytest


def seeds(few: int, many: int) -> list:
    """The first `few` of `many` seeds always, the others in the soak."""
    return [*range(few), *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(few, many))]
