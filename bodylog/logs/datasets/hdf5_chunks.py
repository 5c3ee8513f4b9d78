"""What HDF5 would unpack to read a dataset, from the
sizes that stand in the file, before anything is read.
"""

import math
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ...errors import FormatError
from ..limits import LIMITS, Input
from ..records import Array

_PIECE = 4 << 20
"""Bytes of rows that are read at once, or of one chunk if that is more."""
_MOST_AT_ONCE = 64 << 20
"""Bytes of rows that are read at once where a chunk
spans more rows: such a chunk is unpacked more than once.
"""
_MOST_CHUNKS = 1 << 18
"""Chunks of a dataset: HDF5 looks for 10 000 a second, stored or not."""
_CHUNKS_AT_ONCE = 1024
"""HDF5 keeps some hundred bytes for each chunk of a request, whether it is stored or not."""
_MOST_EXPANSION = 1032
"""Bytes of which deflate makes one: 258 bytes from two bits."""
_OVERHEAD = 1 << 16
"""Bytes that a filter may add to a chunk that it cannot compress."""
_DEFLATE = 1
_COMPRESSING: Mapping[int, str] = {_DEFLATE: "gzip", 4: "szip", 32000: "lzf"}
_REARRANGING: Mapping[int, str] = {2: "shuffle", 3: "fletcher32"}


def explain_refused_dataset(one: Any, limits: Input) -> str | None:
    """Why a dataset may not be read: its chunks, its
    filters, or what is stored of them; None if it may.
    """
    if one.chunks is None:
        return None
    size = chunk_bytes(one)
    if size > limits.max_message_mb * 1e6:
        asked = f"type in robot.toml: [input] max_message_mb = {math.ceil(size / 1e6)}"
        return f"chunks of {size} bytes; to read them, {asked}"
    if (
        chunks := math.prod(math.ceil(a / b) for a, b in zip(one.shape, one.chunks, strict=True))
    ) > _MOST_CHUNKS:
        return f"{chunks} chunks; at most {_MOST_CHUNKS} are read"
    return _refused_filters(one) or _refused_storage(one, size)


def chunk_bytes(one: Any) -> int:
    """Bytes that HDF5 unpacks at once; 0 for a dataset without chunks."""
    values: int = math.prod(one.chunks) if one.chunks else 0
    return values * int(one.id.get_type().get_size())


def read_float_rows(one: Any, limits: Input = LIMITS) -> Array:
    """All rows as float64 (N,K), block by block; FormatError
    where a chunk unpacks to more than it declares.
    """
    values = np.empty((one.shape[0], math.prod(one.shape[1:])))
    for first, rows in row_blocks(one, one.shape[0], limits):
        values[first : first + len(rows)] = rows.reshape(len(rows), -1)
    return values


def row_blocks(
    one: Any, count: int, limits: Input = LIMITS, start: int = 0
) -> Iterator[tuple[int, Array]]:
    """Rows from `start` to before `count`: (number of the
    first, rows), some megabytes or a chunk at a time.

    FormatError where a chunk unpacks to more than it declares.
    """
    step = rows_at_once(one)
    large = _large_chunks(one, limits)
    for first in range(start, count, step):
        end = min(first + step, count)
        for offset in large:
            if first <= offset[0] < end:
                _check_stream(one, offset)
        yield first, one[first:end]


def rows_at_once(one: Any) -> int:
    """Rows that are read in one request: whole chunks, where that is not too much."""
    width = math.prod(one.shape[1:]) * one.dtype.itemsize
    rows = int(max(1, _PIECE // max(width, 1)))
    if not one.chunks:
        return rows
    across = math.prod(math.ceil(a / b) for a, b in zip(one.shape[1:], one.chunks[1:], strict=True))
    chunks = min(rows // one.chunks[0], _CHUNKS_AT_ONCE // max(across, 1))
    most = max(1, _MOST_AT_ONCE // max(width, 1))
    return int(min(one.chunks[0] * max(chunks, 1), most))


def _dataset_filter_codes(one: Any) -> list[int]:
    """The codes of a dataset's filters, in the order of writing."""
    plist = one.id.get_create_plist()
    return [int(plist.get_filter(number)[0]) for number in range(plist.get_nfilters())]


def _refused_filters(one: Any) -> str | None:
    """Why its filters are refused: two that compress would expand a million times."""
    codes = _dataset_filter_codes(one)
    known = {**_COMPRESSING, **_REARRANGING}
    if strange := [code for code in codes if code not in known]:
        return f"packed by HDF5's filter {strange[0]}; possible: {', '.join(known.values())}"
    if sum(code in _COMPRESSING for code in codes) > 1:
        return f"packed twice, by {' and '.join(known[code] for code in codes)}"
    return None


def _refused_storage(one: Any, size: int) -> str | None:
    """Why what is stored is refused: more bytes than a chunk of `size` bytes can take."""
    longest = 0

    def examine(about: Any) -> None:
        nonlocal longest
        longest = max(longest, about.size)

    if set(_dataset_filter_codes(one)) & set(_COMPRESSING):
        one.id.chunk_iter(examine)
    return (
        f"{longest} bytes are stored of a chunk of {size}"
        if longest > size + size // 8 + _OVERHEAD
        else None
    )


def _large_chunks(one: Any, limits: Input) -> list[tuple[int, ...]]:
    """The places of chunks that may unpack to more than
    a message may: HDF5 unpacks a stream to its end.
    """
    found: list[tuple[int, ...]] = []

    def examine(about: Any) -> None:
        if about.size * _MOST_EXPANSION > limits.max_message_mb * 1e6:
            found.append(about.chunk_offset)

    if one.chunks and _DEFLATE in _dataset_filter_codes(one):
        one.id.chunk_iter(examine)
    return found


def _check_stream(one: Any, offset: tuple[int, ...]) -> None:
    """FormatError if a chunk's stream does not end
    within the chunk; it is unpacked piece by piece.
    """
    size = chunk_bytes(one)
    found = 0
    unpacker = zlib.decompressobj()
    packed = one.id.read_direct_chunk(offset)[1]
    while packed and not unpacker.eof and found <= size:
        try:
            found += len(unpacker.decompress(packed, _PIECE))
        except zlib.error:
            return  # HDF5 refuses it too
        packed = unpacker.unconsumed_tail
    if found > size:
        raise FormatError(f"{one.name}: a chunk of {size} bytes unpacks to more")
