"""Gather the bytes of many messages as rows, compare them, view them as numbers."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..records import Array
from .cursor import FieldLeaf
from .layout import MessageLayout

_BLOCK = 512
_BYTES = 1 << 20
"""Rows to compare at a time, and the most bytes of copies of their template."""


class Template(NamedTuple):
    """A layout prepared to compare `block` rows at a time,
    `words` times eight bytes each, with its constants.

    mask, reference (block · words,): which bits are constant, and their values.
    """

    layout: MessageLayout
    words: int
    block: int
    mask: Array
    reference: Array


def make_template(
    layout: MessageLayout, payload: bytes, high: Sequence[tuple[int, int]] = ()
) -> Template:
    """The template of the message with this layout; in
    the byte ranges `high` only the highest bit is fixed.
    """
    words = -(-layout.width // 8)
    mask, reference = np.zeros((2, 8 * words), np.uint8)
    for start, stop in layout.constants:
        mask[start:stop] = 0xFF
        reference[start:stop] = np.frombuffer(payload, np.uint8, stop - start, start)
    for start, stop in high:
        mask[start:stop] |= 0x80
        reference[start:stop] = np.frombuffer(payload, np.uint8, stop - start, start)
    block = max(1, min(_BLOCK, _BYTES // max(1, layout.width)))
    return Template(
        layout, words, block, *(np.tile(row.view(np.uint64), block) for row in (mask, reference))
    )


def match_template(rows: Array, known: Template) -> Array:
    """True (n,) for the rows whose constant bytes equal the template's."""
    words = rows.view(np.uint64).reshape(-1)
    same = np.ones(len(rows), bool)
    # Block by block: a temporary as large as all rows
    # would cost more in page faults than the comparison.
    for start in range(0, len(rows), known.block):
        block = words[start * known.words : (start + known.block) * known.words]
        differs = (block ^ known.reference[: len(block)]) & known.mask[: len(block)]
        if differs.max(initial=0):
            same[start : start + known.block] = np.logical_not(
                differs.reshape(-1, known.words).any(axis=1)
            )
    return same


def gather_rows(data: Array, offset: Array, width: int) -> Array:
    """Rows (n,width) of bytes from the offsets; bytes past the end of `data` are 0."""
    if not len(offset) or not width:
        return np.empty((len(offset), width), np.uint8)
    over = int(offset.max()) + width - len(data)
    if over > 0:
        near = offset > len(data) - width
        tail = np.concatenate([data[int(offset[near].min()) :], np.zeros(over, np.uint8)])
        rows = np.empty((len(offset), width), np.uint8)
        rows[near] = gather_rows(tail, offset[near] - offset[near].min(), width)
        rows[~near] = gather_rows(data, offset[~near], width)
        return rows
    windows = np.ndarray((len(data) - width + 1,), f"V{width}", data, 0, (1,))
    return windows[offset].view(np.uint8).reshape(len(offset), width)


def read_leaf_values(rows: Array, leaf: FieldLeaf) -> Array | tuple[str, ...]:
    """A leaf's values (m,) or (m,K) in native byte
    order, times in ns, missing ones NaN; or its texts.
    """
    if leaf.texts is not None:
        return leaf.texts
    if leaf.single and not len(leaf.offsets):
        return np.full(len(rows), np.nan)
    values = _to_native_order(_strided_elements(rows, leaf.offsets, leaf.dtype))
    if (leaf.offsets < 0).any():
        values = np.where(leaf.offsets < 0, np.nan, values)
    return values[:, 0] if leaf.single else values


def _strided_elements(rows: Array, offsets: Array, dtype: np.dtype[Any]) -> Array:
    count, width = rows.shape
    steps = np.diff(offsets)
    if not len(offsets):
        return np.empty((count, 0), dtype)
    if (offsets >= 0).all() and (not len(steps) or (steps == steps[0]).all()):
        step = int(steps[0]) if len(steps) else 0
        return np.ndarray((count, len(offsets)), dtype, rows, int(offsets[0]), (width, step))
    single = [
        np.ndarray((count,), dtype, rows, max(int(offset), 0), (width,)) for offset in offsets
    ]
    return np.stack(single, axis=1)


def _to_native_order(values: Array) -> Array:
    if values.dtype.names:
        return values["sec"].astype(np.int64) * 1_000_000_000 + values["nanosec"].astype(np.int64)
    return np.array(values, values.dtype.newbyteorder("="), order="C")
