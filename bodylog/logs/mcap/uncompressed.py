"""Chunks stored as they are: their records lie in the file itself, so many chunks are looked at as one."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import groupby

import numpy as np
from isal.isal_zlib import crc32

from ...errors import FormatError
from ..records import Array
from ..storage.compression import STORED
from ..storage.mmapped import advise_sequential
from .chunks import Chunk, Loose, MessageRecords, chunk_head, indexed, records_at

_TOGETHER = 16 << 20


def runs(parts: Sequence[Chunk | Loose]) -> Iterator[list[Chunk | Loose]]:
    """The parts in order: stored chunks that begin in the same 16 MB of the file together, others between them.

    The first part comes alone, since who looks at a log's beginning wants no more.
    """

    def key(part: Chunk | Loose) -> tuple[bool, int]:
        if isinstance(part, Loose) or not part.stored or not part.indexes:
            return False, 0
        return True, 0 if part is parts[0] else 1 + part.start // _TOGETHER

    return (list(some) for _, some in groupby(parts, key))


def together(data: memoryview, parts: Sequence[Chunk | Loose], alone: bool) -> tuple[Array, MessageRecords] | None:
    """The file (bytes,) uint8 and all messages in a run of stored chunks.

    `alone`: what lies around it is not wanted.
    None when the run is of others, or when a CRC or an index in it is wrong: each is to be looked at by itself.
    """
    chunks = [part for part in parts if isinstance(part, Chunk) and part.stored and part.indexes]
    if len(chunks) < len(parts):
        return None
    for first, last in [(c, c) for c in chunks] if alone else [(chunks[0], chunks[-1])]:
        advise_sequential(data, first.start, last.start + last.length, alone)
    places = [place for chunk in chunks if (place := _sound(data, chunk))]
    whole = np.frombuffer(data, np.uint8)
    found = indexed(whole, places, data, chunks) if len(places) == len(chunks) else None
    return None if found is None else (whole, found)


def _sound(data: memoryview, chunk: Chunk) -> tuple[int, int] | None:
    """Where in the file a stored chunk's records are; None when it is not what its head says."""
    with suppress(FormatError):
        _, _, size, crc, compression, packed = chunk_head(data, chunk.start)
        if compression in STORED and len(packed) == size and (not crc or crc32(packed) == crc):
            low = records_at(chunk, compression)
            return low, low + size
    return None
