"""Uncompressed chunks: their records lie in the file itself, so many chunks are read as one."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import groupby

import numpy as np
from isal.isal_zlib import crc32

from ...errors import FormatError
from ..records import Array
from ..storage.compression import STORED
from ..storage.mmapped import advise_sequential
from .chunks import (
    Chunk,
    LooseRecords,
    MessageRecords,
    chunk_head,
    list_indexed_messages,
    records_at,
)

_TOGETHER = 16 << 20


def group_uncompressed_chunks(
    parts: Sequence[Chunk | LooseRecords],
) -> Iterator[list[Chunk | LooseRecords]]:
    """The parts in order, with uncompressed chunks
    grouped that begin in the same 16 MB of the file.

    The first part is alone, as some callers read only a log's beginning.
    """

    def key(part: Chunk | LooseRecords) -> tuple[bool, int]:
        if isinstance(part, LooseRecords) or not part.stored or not part.indexes:
            return False, 0
        return True, 0 if part is parts[0] else 1 + part.start // _TOGETHER

    return (list(some) for _, some in groupby(parts, key))


def read_uncompressed_run(
    data: memoryview, parts: Sequence[Chunk | LooseRecords], alone: bool
) -> tuple[Array, MessageRecords] | None:
    """The file (bytes,) uint8 and all messages in a run of uncompressed chunks.

    `alone`: the bytes around it are not needed. None when the run holds other parts, or a CRC or
    index in it is wrong: read each part separately.
    """
    chunks = [part for part in parts if isinstance(part, Chunk) and part.stored and part.indexes]
    if len(chunks) < len(parts):
        return None
    for first, last in [(c, c) for c in chunks] if alone else [(chunks[0], chunks[-1])]:
        advise_sequential(data, first.start, last.start + last.length, alone)
    places = [place for chunk in chunks if (place := _sound_chunk_bounds(data, chunk))]
    whole = np.frombuffer(data, np.uint8)
    found = (
        list_indexed_messages(whole, places, data, chunks) if len(places) == len(chunks) else None
    )
    return None if found is None else (whole, found)


def _sound_chunk_bounds(data: memoryview, chunk: Chunk) -> tuple[int, int] | None:
    """Where in the file an uncompressed chunk's records are; None when its head or CRC is wrong."""
    with suppress(FormatError):
        _, _, size, crc, compression, packed = chunk_head(data, chunk.start)
        if compression in STORED and len(packed) == size and (not crc or crc32(packed) == crc):
            low = records_at(chunk, compression)
            return low, low + size
    return None
