"""Cells of a table, whatever the file: names of columns, numbers, texts."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError
from ..records import Array

EMPTY = frozenset(("", "nan", "na", "n/a", "null", "none", "-"))
"""Cells, in lower case, that count as empty."""
OBJECT_BYTES = 64
"""What a value takes as a Python object, beside its text."""
_MOST_COLUMNS = 10_000


def column_names(names: list[str], path: Path) -> list[str]:
    """The names of the columns; FormatError when they are missing or not unique."""
    if not any(names):
        raise FormatError(f"{path}: the table has no header; name its columns in the first line")
    if all(is_number(name) for name in names if name):
        raise FormatError(
            f"{path}: the first line holds numbers ({', '.join(names[:3])}); it must name "
            "the columns"
        )
    if len(names) > _MOST_COLUMNS:
        raise FormatError(f"{path}: {len(names)} columns; at most {_MOST_COLUMNS} are read")
    if twice := next(
        (name for name, count in Counter(filter(None, names)).items() if count > 1), None
    ):
        raise FormatError(
            f"{path}: column {twice!r} occurs {names.count(twice)} times; give each a unique name"
        )
    return names


def cell_text(cell: Any) -> str:
    """A cell as text; an empty one, however its block stores it, is the empty text."""
    return "" if isinstance(cell, float) and cell != cell else str(cell)


def cell_number(cell: Any) -> float:
    """A cell as a number; NaN for a text."""
    try:
        return float(cell)
    except (ValueError, TypeError, OverflowError):
        return float("nan")


def is_number(cell: str) -> bool:
    """Whether a cell is a finite or infinite number."""
    return cell.lower() not in EMPTY and cell_number(cell) == cell_number(cell)


def cell_objects(cells: Sequence[Any]) -> Array:
    """Cells (n,) as a CSV column would hold them."""
    plain = [np.nan if cell is None else cell for cell in cells]
    if all(isinstance(cell, int | float) for cell in plain):
        return np.array([cell_number(cell) for cell in plain])
    out = np.empty(len(plain), dtype=object)
    out[:] = [cell if isinstance(cell, float) else str(cell) for cell in plain]
    return out


def exception_line(problem: Exception) -> str:
    """An exception's text as one line."""
    return " ".join(str(problem).split())[:200]
