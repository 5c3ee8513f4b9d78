"""Group the JSON or protobuf messages of a batch by layout and decode each group at once; layouts are reused."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ...errors import FormatError
from ..records import Array, Batch, Topic
from .json_layouts import JsonLayout, mark_runs, skeleton
from .message_path import Step
from .protobuf import root_of
from .protobuf_layouts import ProtobufLayout

_MOST_LAYOUTS = 64
"""Layouts per topic: with more, messages share too little for batch decoding to pay."""

_FEW = 4
"""So few messages decode faster one by one."""

_BETWEEN, _WIDEST_GAP = b"\n", 64
"""Overwrites up to so many bytes between two payloads."""

Found = Iterator[tuple[Array, list[Any]]]
"""Indices (m,) of messages in a batch and, by path, their values (m,), (m,K) or texts."""

_UNLIKE = (FormatError, KeyError, ValueError, TypeError, RecursionError)


class JsonBatchDecoder:
    """Decodes JSON messages at once that differ only in numbers."""

    def __init__(self, paths: Sequence[tuple[Step, ...]], single: Sequence[int | None]) -> None:
        """Start without a known layout."""
        self._paths, self._single = paths, single
        self._known: dict[bytes, JsonLayout | None] = {}

    def take(self, batch: Batch) -> Found:
        """Decode the messages that share a layout."""
        if len(batch.offset) <= _FEW:
            return
        content, begin, between = _joined(batch)
        runs = mark_runs(content)
        if runs is None:
            return
        end = begin + batch.length
        key = skeleton(content[: end[0]])
        if len(runs) % len(begin) == 0 and skeleton(content) + between == (key + between) * len(begin):
            yield from self._read(key, np.arange(len(begin)), content, (begin, end), runs.reshape(len(begin), -1))
            return
        groups: dict[bytes, list[int]] = {}
        for index, (low, high) in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
            groups.setdefault(skeleton(content[low:high]), []).append(index)
        first, last = np.searchsorted(runs, begin), np.searchsorted(runs, end)
        for key, some in groups.items():
            rows = np.array(some)
            count = last[rows] - first[rows]
            if len(some) > _FEW and (count == count[0]).all():
                own = runs[first[rows, None] + np.arange(count[0])]
                yield from self._read(key, rows, content, (begin[rows], end[rows]), own)

    def _read(self, key: bytes, index: Array, content: bytearray, span: tuple[Array, Array], runs: Array) -> Found:
        """Decode the messages `index` (m,) of a skeleton if their layouts agree.

        They extend over the bytes `span` (m,), (m,) of `content`, their runs are `runs` (m,2R).
        """
        begin, end = span
        layout = self._layout(key, content[begin[0] : end[0]], runs[0] - begin[0])
        values = layout.values(content, begin, runs, self._single) if layout else None
        if values is not None:
            yield index, values

    def _layout(self, key: bytes, payload: bytearray, runs: Array) -> JsonLayout | None:
        if key not in self._known and len(self._known) < _MOST_LAYOUTS:
            try:
                from .object_values import follow

                self._known[key] = JsonLayout(bytes(payload), runs, self._paths, follow)
            except _UNLIKE:
                self._known[key] = None
        return self._known.get(key)


def _joined(batch: Batch) -> tuple[bytearray, Array, bytes]:
    """All payloads concatenated, where each begins (n,), and the separator between two of them."""
    ends = batch.offset + batch.length
    gaps = batch.offset[1:] - ends[:-1]
    gap = int(gaps[0])
    if (gaps == gap).all() and 0 <= gap <= _WIDEST_GAP:  # in place, with the message heads between them overwritten
        low = int(batch.offset[0])
        content = bytearray(batch.data[low : int(ends[-1])])
        if gap:
            np.ndarray(len(content) - gap, f"V{gap}", content, strides=(1,))[ends[:-1] - low] = np.void(_BETWEEN * gap)
        return content, batch.offset - low, _BETWEEN * gap
    data = batch.data.data
    pieces = [data[a:b] for a, b in zip(batch.offset.tolist(), ends.tolist(), strict=True)]
    return bytearray().join(pieces), np.cumsum(batch.length) - batch.length, b""


class ProtobufBatchDecoder:
    """Decodes protobuf messages at once that have the same fields in the same order, and equal length."""

    def __init__(self, topic: Topic, paths: Sequence[tuple[Step, ...]], single: Sequence[int | None]) -> None:
        """Start without a known layout; FormatError when the topic's schema is broken."""
        self._types, self._root = root_of(topic)
        self._paths, self._single = paths, single
        self._known: dict[int, list[ProtobufLayout]] = {}
        self._count = 0

    def take(self, batch: Batch) -> Found:
        """Decode the messages that share a layout."""
        for length in np.unique(batch.length).tolist():
            index = np.flatnonzero(batch.length == length)
            for layout in self._known.get(length, ()):
                index = yield from self._same_layout(batch, index, layout)
            while len(index) > _FEW and self._count < _MOST_LAYOUTS:
                learned = self._learn(batch, int(index[0]))
                if learned is None:
                    index = index[1:]
                else:
                    index = yield from self._same_layout(batch, index, learned)

    def _same_layout(self, batch: Batch, index: Array, layout: ProtobufLayout) -> Any:
        """Yield the decoded messages of this layout; return the others."""
        if not len(index):
            return index
        same, values = layout.values(batch, index, self._single)
        if values is None or not same.any():
            return index if values is not None else index[~same]
        yield index[same], values
        return index[~same]

    def _learn(self, batch: Batch, index: int) -> ProtobufLayout | None:
        start = int(batch.offset[index])
        payload = batch.data[start : start + int(batch.length[index])].tobytes()
        self._count += 1
        try:
            from .object_values import follow

            layout = ProtobufLayout(payload, self._types, self._root, self._paths, follow)
        except _UNLIKE:
            return None
        self._known.setdefault(layout.width, []).append(layout)
        return layout
