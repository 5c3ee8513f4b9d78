"""The result of decoding a topic: its columns, in parts of messages with equally many values."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..records import Array


class ColumnPart(NamedTuple):
    """Messages with equally many values: rows (m,) into the
    columns · per field an array (m,) or (m,K), or texts.
    """

    rows: Array
    values: tuple[Array | tuple[str, ...], ...]


class TopicColumns(NamedTuple):
    """Fields of one topic: log_ns (n,) of every message in
    file order, parts that cover the sound ones, counts.
    """

    fields: tuple[str, ...]
    log_ns: Array
    parts: tuple[ColumnPart, ...]
    fast: int
    fallback: int
    rejected: Mapping[str, int]

    @property
    def sound(self) -> Array:
        """Rows (m,) that were decoded, ascending."""
        return (
            np.sort(np.concatenate([part.rows for part in self.parts]))
            if self.parts
            else np.empty(0, np.int64)
        )

    def column(self, name: str) -> Array:
        """One field of the sound rows in file order: (m,)
        or (m,K); shorter rows are padded with NaN or "".
        """
        which = self.fields.index(name)
        arrays = [_count_spread(part.values[which], len(part.rows)) for part in self.parts]
        if not arrays:
            return np.empty(0)
        order = np.argsort(np.concatenate([part.rows for part in self.parts]), kind="stable")
        if any(array.dtype.kind == "U" for array in arrays):  # missing texts have no dtype
            arrays = [array if array.size else array.astype(np.str_) for array in arrays]
        if len({array.shape[1:] for array in arrays}) > 1:
            arrays = [array if array.ndim == 2 else array[:, None] for array in arrays]
            arrays = [
                _pad_to_width(array, max(other.shape[1] for other in arrays)) for array in arrays
            ]
        return np.concatenate(arrays)[order]


def _count_spread(values: Array | tuple[str, ...], count: int) -> Array:
    if isinstance(values, np.ndarray):
        return values
    return np.broadcast_to(np.array(values, np.str_), (count, len(values)))


def _pad_to_width(array: Array, width: int) -> Array:
    texts = array.dtype.kind == "U"
    out = np.full(
        (len(array), width), "" if texts else np.nan, array.dtype if texts else np.float64
    )
    out[:, : array.shape[1]] = array
    return out


def join_parts(pieces: list[tuple[Array, list[Any]]]) -> ColumnPart:
    """Rows and values of equal shape as one part."""
    rows = np.concatenate([index for index, _ in pieces])
    columns = zip(*(values for _, values in pieces), strict=True)
    return ColumnPart(
        rows,
        tuple(some[0] if isinstance(some[0], tuple) else np.concatenate(some) for some in columns),
    )
