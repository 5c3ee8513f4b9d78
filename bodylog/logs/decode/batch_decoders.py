"""Group the JSON or protobuf messages of a batch by layout and decode each group at once; layouts are reused."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ...errors import FormatError
from ..records import Array, Batch, Topic
from .json_layouts import JsonLayout, marked, skeleton
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
        joined, begin, between = _joined(batch)
        content = marked(joined)
        if not content:
            return
        size = batch.length
        key = skeleton(content[: size[0]])
        if skeleton(content) + between == (key + between) * len(begin):
            yield from self._read(key, np.arange(len(begin)), content, begin)
            return
        groups: dict[bytes, list[int]] = {}
        payloads = [content[a:b] for a, b in zip(begin.tolist(), (begin + size).tolist(), strict=True)]
        for index, payload in enumerate(payloads):
            groups.setdefault(skeleton(payload), []).append(index)
        for key, some in groups.items():
            if len(some) > _FEW:
                rows = np.array(some)
                start = np.cumsum(size[rows]) - size[rows]
                yield from self._read(key, rows, b"".join([payloads[one] for one in some]), start)

    def _read(self, key: bytes, index: Array, content: bytes, begin: Array) -> Found:
        """Decode the messages `index` (m,) of a skeleton, which begin at bytes `begin` (m,), if their layouts agree."""
        layout = self._layout(key, content[: begin[1]].rstrip(_BETWEEN))
        values = layout.values(content, begin, self._single) if layout else None
        if values is not None:
            yield index, values

    def _layout(self, key: bytes, payload: bytes) -> JsonLayout | None:
        if key not in self._known and len(self._known) < _MOST_LAYOUTS:
            try:
                from .object_values import follow

                self._known[key] = JsonLayout(payload, self._paths, follow)
            except _UNLIKE:
                self._known[key] = None
        return self._known.get(key)


def _joined(batch: Batch) -> tuple[Array, Array, bytes]:
    """All payloads concatenated (bytes,) uint8, where each begins (n,), and the separator between two of them."""
    ends = batch.offset + batch.length
    gaps = batch.offset[1:] - ends[:-1]
    gap = int(gaps[0])
    if (gaps == gap).all() and 0 <= gap <= _WIDEST_GAP:  # in place, with the message heads between them overwritten
        low = int(batch.offset[0])
        content = np.array(batch.data[low : int(ends[-1])])
        content[(ends[:-1] - low)[:, None] + np.arange(gap)] = _BETWEEN[0]
        return content, batch.offset - low, _BETWEEN * gap
    data = batch.data.data
    pieces = [data[a:b] for a, b in zip(batch.offset.tolist(), ends.tolist(), strict=True)]
    return np.frombuffer(bytearray().join(pieces), np.uint8), np.cumsum(batch.length) - batch.length, b""


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
