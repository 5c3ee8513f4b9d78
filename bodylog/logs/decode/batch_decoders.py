"""Decode the JSON or protobuf messages of a batch together; what is unlike the others is left."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ...errors import FormatError
from ..records import Array, Batch, Topic
from .message_path import Step
from .object_places import shape_values
from .protobuf import root_of
from .protobuf_layouts import ProtobufLayout

_MOST_LAYOUTS = 64
"""Layouts per topic: with more, messages share too little for batch decoding to pay."""

_FEW = 4
"""So few messages decode faster one by one."""

Found = Iterator[tuple[Array, list[Any]]]
"""Indices (m,) of messages in a batch and, by path, their values (m,), (m,K) or texts."""

_UNLIKE = (FormatError, KeyError, ValueError, TypeError, RecursionError)


class JsonBatchDecoder:
    """Decodes only those members of JSON objects at
    which message paths begin, for a batch at once.
    """

    def __init__(self, paths: Sequence[tuple[Step, ...]], single: Sequence[int | None]) -> None:
        """For message paths; none is read together if one does not begin with a member."""
        import msgspec

        self._paths = paths
        self._single = single
        self._errors = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
        members = list(
            dict.fromkeys(steps[0] for steps in paths if steps and isinstance(steps[0], str))
        )
        self._attributes = {member: f"member_{k}" for k, member in enumerate(members)}
        fields = [
            (attribute, Any, msgspec.field(name=member))
            for member, attribute in self._attributes.items()
        ]
        self._decode = msgspec.json.Decoder(msgspec.defstruct("Members", fields, gc=False)).decode

    def take(self, batch: Batch) -> Found:
        """Decode the messages that are strict JSON and
        have all members, if their values have one shape.

        What strict JSON lacks (NaN, lone surrogates, UTF-16,
        numbers beyond floats) is left for the standard library.
        """
        if not all(steps and isinstance(steps[0], str) for steps in self._paths):
            return
        index = []
        messages = []
        data = batch.data.data
        ends = batch.offset + batch.length
        for row, (begin, end) in enumerate(zip(batch.offset.tolist(), ends.tolist(), strict=True)):
            try:
                messages.append(self._decode(data[begin:end]))
            except self._errors:
                continue
            index.append(row)
        if not messages:
            return
        values: list[Any] = []
        for steps, single in zip(self._paths, self._single, strict=True):
            attribute = self._attributes[str(steps[0])]
            column = _column_of(
                [getattr(message, attribute) for message in messages], steps[1:], single
            )
            if column is None:
                return
            values.append(column)
        yield np.array(index), values


def _column_of(
    values: list[Any], steps: Sequence[Step], single: int | None
) -> Array | tuple[str, ...] | None:
    """The numbers (n,) or (n,K) or equal texts at the end
    of the steps; None where values must be read one by one.
    """
    from .object_values import follow_steps

    try:
        for step in steps:
            if not isinstance(step, str):
                values = [list(follow_steps(value, (step,))) for value in values]
            else:
                values = [value[step] for value in values]
        if isinstance(values[0], dict):
            values = [next(follow_steps(value, ()), None) for value in values]
    except _UNLIKE:
        return None
    texts = values[0] if isinstance(values[0], list) else [values[0]]
    if texts and all(type(text) is str and text.isascii() for text in texts):
        return tuple(texts) if values.count(values[0]) == len(values) else None
    try:
        found = np.array(values)
    except ValueError:  # arrays of several lengths
        return None
    if found.dtype not in (np.float64, np.int64) or found.ndim > 2:
        return None
    return shape_values(found.reshape(len(found), -1), single)


class ProtobufBatchDecoder:
    """Decodes protobuf messages at once that have the
    same fields in the same order, and equal length.
    """

    def __init__(
        self, topic: Topic, paths: Sequence[tuple[Step, ...]], single: Sequence[int | None]
    ) -> None:
        """Start without a known layout; FormatError when the topic's schema is broken."""
        self._types, self._root = root_of(topic)
        self._paths = paths
        self._single = single
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
            from .object_values import follow_steps

            layout = ProtobufLayout(payload, self._types, self._root, self._paths, follow_steps)
        except _UNLIKE:
            return None
        self._known.setdefault(layout.width, []).append(layout)
        return layout
