"""Errors by the length of the exploration, over rendered logs."""

from tests.validation import figures
from tests.validation.explorations import Case, rows

SECONDS = (5.0, 10.0, 20.0, 40.0)


def table():
    """A row for each length."""
    head = ("exploration, s", "error of the body, px", "error of `reach`, rad", "error of `drift`, rad")
    cases = [Case(seconds=seconds) for seconds in SECONDS]
    return figures.table(head, [(f"{case.seconds:g}", *row[1:]) for case, row in zip(cases, rows(cases), strict=True)])
