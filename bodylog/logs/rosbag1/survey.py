"""The content of a ROS 1 bag, as far as it was surveyed."""

from dataclasses import dataclass, field

import numpy as np

from ..records import Array
from .chunks import BagChunk, BagRun
from .records import BagRecord, fields_of


@dataclass
class BagSurvey:
    """Connections by id, counts by id, parts in file order, log times (ns)."""

    connections: dict[int, dict[bytes, bytes]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    parts: list[BagChunk | BagRun] = field(default_factory=list)
    times: list[int] = field(default_factory=list)

    def declare(self, record: BagRecord, data: memoryview) -> None:
        """Add a connection; the first one of an id is kept."""
        fields = {**fields_of(data, record.body, record.end), **record.fields}
        self.connections.setdefault(
            record.number(b"conn"), {name: bytes(value) for name, value in fields.items()}
        )

    def count(self, connections: Array, log_ns: Array) -> None:
        """Count messages by connection (n,) and log time (n,) ns."""
        if len(connections):
            for connection, number in zip(*np.unique(connections, return_counts=True), strict=True):
                self.counts[int(connection)] = self.counts.get(int(connection), 0) + int(number)
            self.times += [int(log_ns.min()), int(log_ns.max())]
