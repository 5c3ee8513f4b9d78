"""Decompress chunks one after another, the next one
in the background while the current one is used.
"""

import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from ...errors import FormatError
from ..diagnostics import Diagnostics
from ..records import Array
from ..storage.compression import Buffer
from ..storage.mmapped import advise_sequential
from .chunks import Chunk, LooseRecords, unpack_chunk

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

_SMALL = 4 << 20
"""Bytes of a log that decompress faster than a thread starts."""

_SHORT = 1 << 14
_LONG = 8 << 20
"""Packed bytes: handing over a shorter chunk costs more
than it saves; two longer ones take too much memory.
"""

Unpacked = Array | FormatError | None
"""A chunk's records, or why there are none; None for messages outside chunks."""


def unpacked_parts(
    data: memoryview,
    parts: Sequence[Chunk | LooseRecords],
    diagnostics: Diagnostics,
    alone: bool = False,
) -> Iterator[tuple[Chunk | LooseRecords, Unpacked]]:
    """Each part with its decompressed records, valid
    until the next; `alone`: nothing between is needed.
    """
    if len(parts) < 3 or parts[-1].start - parts[0].start < _SMALL or _count_processors() < 2:
        buffer = Buffer(diagnostics.path, diagnostics.limits)
        yield from ((part, _unpack_part(data, part, buffer, alone)) for part in parts)
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        yield from _overlap_unpacking(data, parts, pool, diagnostics, alone)


def _overlap_unpacking(
    data: memoryview,
    parts: Sequence[Chunk | LooseRecords],
    pool: "ThreadPoolExecutor",
    diagnostics: Diagnostics,
    alone: bool,
) -> Iterator[tuple[Chunk | LooseRecords, Unpacked]]:
    """Alternate between two buffers; the first part is not
    overlapped, as some callers read only a log's beginning.
    """
    here = Buffer(diagnostics.path, diagnostics.limits)
    there = Buffer(diagnostics.path, diagnostics.limits)
    waiting: Future[Unpacked] | None = None
    for number, part in enumerate(parts):
        found = waiting.result() if waiting else _unpack_part(data, part, here, alone)
        following = parts[number + 1] if 0 < number < len(parts) - 1 else None
        pays = isinstance(following, Chunk) and _SHORT <= following.length <= _LONG
        waiting = (
            pool.submit(_unpack_part, data, following, there, alone) if following and pays else None
        )
        yield part, found
        here, there = there, here


def _unpack_part(
    data: memoryview, part: Chunk | LooseRecords, buffer: Buffer, alone: bool
) -> Unpacked:
    if isinstance(part, LooseRecords):
        return None
    advise_sequential(data, part.start, part.start + part.length, alone)
    try:
        return unpack_chunk(data, part, buffer)
    except FormatError as problem:
        return problem


def _count_processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
