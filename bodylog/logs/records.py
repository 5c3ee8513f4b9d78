"""The records of the log layer: topics, batches of messages, frames, findings."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Finding:
    """One finding about a log: severity `info`, `warning`
    or `lost` (data was lost: exit 3), and one line of text.
    """

    severity: str
    text: str


@dataclass(frozen=True, eq=False)
class Topic:
    """One channel of a log as its file declares it; `type` is normalised to package/msg/Name."""

    id: int
    name: str
    type: str
    encoding: str
    definition: bytes
    definition_encoding: str
    messages: int
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Batch:
    """Messages of one topic id, undecoded: payload i is data[offset[i] : offset[i] + length[i]].

    log_ns (n,) int64 · data (bytes,) uint8 · offset, length (n,) int64. `data` may be a reused
    buffer: it is valid only until the next batch is requested.
    """

    topic_id: int
    log_ns: Array
    data: Array
    offset: Array
    length: Array


@dataclass(frozen=True, eq=False)
class Outgoing:
    """Messages of one topic to write: payloads as in Batch, log_ns (n,) int64 ascending."""

    topic: str
    type: str
    definition: bytes
    log_ns: Array
    data: Array
    offset: Array
    length: Array
    encoding: str = "cdr"
    definition_encoding: str = "ros2msg"


@dataclass(frozen=True, eq=False)
class LazyImage:
    """One image, decoded on demand: decode(k) gives (H/k,
    W/k, 3) uint8 BGR for k in 1, 2, 4, 8; thread safe.

    The result may be a read-only view of the log's own bytes, in any memory order.

    `shrinks`: decode(2) may be cheaper than decode(1), and gives the means of 2 by 2 pixels.
    `held_bytes`: memory that it keeps until it is decoded; 0 where its bytes stay in the file.
    """

    t: float
    source_ns: int
    decode: Callable[[int], Array] = field(repr=False)
    shrinks: bool = False
    held_bytes: int = field(default=0, repr=False)

    @property
    def image(self) -> Array:
        """The full image (H,W,3) uint8 BGR, writable."""
        return np.require(self.decode(1), requirements=("C", "W"))
