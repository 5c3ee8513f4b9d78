"""Errors by the marker and its size, over rendered logs of 20 s."""

from tests.validation import figures
from tests.validation.explorations import AWAY, FOCAL, Case, rows

MARKERS = (("ball", 0.0125), ("ball", 0.025), ("ball", 0.05), ("tag", 0.04), ("tag", 0.08))
CASES = [Case(marker, size, 20.0) for marker, size in MARKERS]


def table():
    """A row for each marker."""
    head = ("feature", "width in the image, px", "images that show it, %", "error of the body, px",
            "error of `reach`, rad", "error of `drift`, rad")  # fmt: skip
    names = [(f"{case.feature}, {100.0 * case.size:g} cm", f"{case.size * FOCAL / AWAY:.0f}") for case in CASES]
    return figures.table(head, [(*name, *row) for name, row in zip(names, rows(CASES), strict=True)])
