"""Logs of one topic that are held in memory, and a topic of protobuf messages."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from bodylog.types import Batch, Topic
from tests.logs.writing import descriptors


class Messages:
    """A log of one topic held in memory, a few messages to a batch."""

    def __init__(self, payloads: list[bytes], batch: int = 4) -> None:
        self.payloads, self.batch = payloads, batch

    def batches(self, ids: Any = None) -> Iterator[Batch]:
        for start in range(0, len(self.payloads), self.batch):
            some = self.payloads[start : start + self.batch]
            length = np.array([len(payload) for payload in some], np.int64)
            data = np.frombuffer(b"".join(some), np.uint8)
            yield Batch(1, np.arange(start, start + len(some)), data, np.cumsum(length) - length, length)


SCHEMA = descriptors("google.protobuf", {"Timestamp": [("seconds", 1, 3, ""), ("nanos", 2, 5, "")]}) + descriptors(
    "robot",
    {
        "Joint": [("name", 1, 9, ""), ("angle", 2, 1, "")],
        "State": [
            ("timestamp", 1, 11, ".google.protobuf.Timestamp"),
            ("joints[]", 2, 11, ".robot.Joint"),
            ("temperature", 3, 2, ""),
            ("offset", 4, 17, ""),
            ("level", 5, 5, ""),
            ("packed_values[]", 6, 1, ""),
            ("counts[]", 7, 13, ""),
            ("label", 8, 9, ""),
            ("wide", 9, 16, ""),
        ],
    },
)


def topic(definition: bytes, encoding: str, type_: str) -> Topic:
    return Topic(1, "/x", type_, encoding, definition, {"json": "jsonschema"}.get(encoding, encoding), 3)


STATE = topic(SCHEMA, "protobuf", "robot.State")
