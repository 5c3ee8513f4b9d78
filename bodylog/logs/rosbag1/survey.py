"""What a ROS 1 bag holds, as far as it was looked at."""

from dataclasses import dataclass, field

import numpy as np

from ..records import Array
from .chunks import BagChunk, BagRun
from .records import BagRecord, fields_of


@dataclass
class BagSurvey:
    """What a bag holds: connections by id, counts by id, parts in file order, log times (ns)."""

    connections: dict[int, dict[bytes, bytes]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    parts: list[BagChunk | BagRun] = field(default_factory=list)
    times: list[int] = field(default_factory=list)

    def declare(self, record: BagRecord, data: memoryview) -> None:
        """Take in a connection; the first one of an id stands."""
        said = {**fields_of(data, record.body, record.end), **record.fields}
        self.connections.setdefault(record.number(b"conn"), {name: bytes(value) for name, value in said.items()})

    def count(self, connections: Array, log_ns: Array) -> None:
        """Take in messages by their connections (n,) and log times (n,) ns."""
        if len(connections):
            for connection, number in zip(*np.unique(connections, return_counts=True), strict=True):
                self.counts[int(connection)] = self.counts.get(int(connection), 0) + int(number)
            self.times += [int(log_ns.min()), int(log_ns.max())]
