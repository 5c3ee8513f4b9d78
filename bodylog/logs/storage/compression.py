"""Decompress chunks into one reused buffer: allocating a new one costs more than lz4 itself."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, LogError
from ..limits import LIMITS, Input
from ..records import Array

NAMES = ("", "none", "lz4", "zstd", "bz2")
"""Compressions of chunks, as MCAP and ROS 1 bags name them."""

STORED = ("", "none")
"""Names for uncompressed chunks."""

_RATIO = 1024
_LIKELY = 16
"""A file, chunk or message may always expand to this many times its size, whatever the limits."""

_PIECE = 128 << 10


class Allowance:
    """How many bytes one chunk or message, and a whole file, may expand to."""

    def __init__(self, path: Path | None, limits: Input) -> None:
        """Start the count for the log at `path`."""
        self._path = path
        self._limits = limits
        self._packed = 0
        self._unpacked = 0

    def single(self, packed: int) -> int:
        """The bytes that a chunk or message of `packed` bytes may expand to."""
        return max(int(self._limits.max_message_mb * 1e6), _LIKELY * packed)

    def take(self, packed: int, size: int) -> None:
        """Count `size` unpacked bytes of `packed` bytes:
        FormatError for too large a one, LogError for the sum.
        """
        if size > self.single(packed):
            asked = f"type in robot.toml: [input] max_message_mb = {math.ceil(size / 1e6)}"
            raise FormatError(
                f"{packed} packed bytes declare {size} bytes; to unpack them, {asked}"
            )
        self._packed = self._packed + packed
        self._unpacked = self._unpacked + size
        self.check(self._packed, self._unpacked)

    def check(self, packed: int, size: int) -> None:
        """LogError, naming the setting, when a file of `packed` bytes may not expand to `size`."""
        whole = self._limits.max_unpacked_gb
        if size > max(int(whole * 1e9), _RATIO * packed):
            text = (
                f"{self._path}: it unpacks to more than {whole:g} GB, {_RATIO} times its size or "
                "more"
            )
            raise LogError(
                f"{text}; to read it, type in robot.toml: [input] max_unpacked_gb = "
                f"{math.ceil(4 * whole)}"
            )


class Buffer:
    """The reused buffer; the result of `load` is valid until the next `load`."""

    def __init__(self, path: Path | None = None, limits: Input = LIMITS) -> None:
        """Start empty, for the log at `path`; the buffer grows to the largest chunk."""
        self._bytes: Array = np.empty(0, np.uint8)
        self._allowance = Allowance(path, limits)

    def load(self, compression: str, packed: memoryview, size: int, partly: bool = False) -> Array:
        """Decompress `packed` to `size` bytes (size,) uint8;
        FormatError on a mismatch or beyond the limits.

        `partly`: `packed` is truncated; return the bytes before the cut.
        """
        if compression in STORED:
            if len(packed) != size and not partly:
                raise FormatError(f"{len(packed)} bytes stored where {size} are declared")
            return np.frombuffer(packed, np.uint8)
        if compression not in _PIECES:
            raise FormatError(f"compression {compression!r}; known are none, lz4, zstd, bz2")
        self._allowance.take(len(packed), size)
        if size > len(self._bytes):
            self._bytes = np.empty(size, np.uint8)
        return self._bytes[: _decompress_into(self._bytes[:size], compression, packed, partly)]


def _decompress_into(target: Array, compression: str, packed: memoryview, partly: bool) -> int:
    """Number of bytes written: all of them, unless `partly`."""
    at = 0
    view = target.data
    try:
        for count in _PIECES[compression](packed, view):
            at += count
    except (OSError, EOFError, RuntimeError, ValueError, _zstd_error()) as problem:
        if not partly:
            raise FormatError(
                f"{compression} data is damaged after {at} bytes: {problem}"
            ) from None
    if at != len(target) and not partly:
        raise FormatError(f"{compression} data holds {at} bytes where {len(target)} are declared")
    return min(at, len(target))


def _zstd_error() -> type[Exception]:
    import zstandard

    return zstandard.ZstdError


def _decompress_zstd(packed: memoryview, target: memoryview) -> Iterator[int]:
    import zstandard

    with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
        at = 0
        while at < len(target) and (count := reader.readinto(target[at:])):
            at += count
            yield count
        yield len(reader.read(1))


def _decompress_lz4(packed: memoryview, target: memoryview) -> Iterator[int]:
    import lz4.frame as lz4

    context = lz4.create_decompression_context()
    used = 0
    at = 0
    ended = False
    while (not ended and used < len(packed)) or (at < len(target) and not ended):
        piece, taken, ended = lz4.decompress_chunk(context, packed[used:], max_length=_PIECE)
        if not piece and not taken:
            return
        used += taken
        yield _place_piece(piece, target, at)
        at += len(piece)


def _decompress_bz2(packed: memoryview, target: memoryview) -> Iterator[int]:
    import bz2

    unpacker = bz2.BZ2Decompressor()
    at = 0
    rest = packed
    while not unpacker.eof:
        piece = unpacker.decompress(rest, max_length=_PIECE)
        if not piece and unpacker.needs_input and not rest:
            return
        rest = packed[:0]
        yield _place_piece(piece, target, at)
        at += len(piece)


def _place_piece(piece: bytes, target: memoryview, at: int) -> int:
    if at + len(piece) > len(target):
        raise ValueError(f"more than the {len(target)} bytes declared")
    target[at : at + len(piece)] = piece
    return len(piece)


_PIECES: dict[str, Any] = {"zstd": _decompress_zstd, "lz4": _decompress_lz4, "bz2": _decompress_bz2}


def unpack_zstd(payload: memoryview, allowance: Allowance) -> bytes:
    """Decompress one zstd frame; FormatError if it is damaged or too large."""
    import zstandard

    try:
        size = zstandard.get_frame_parameters(payload).content_size
        known = size != zstandard.CONTENTSIZE_UNKNOWN
        if known:
            allowance.take(len(payload), size)
        with zstandard.ZstdDecompressor().stream_reader(payload) as reader:
            content = bytes(reader.read((size if known else allowance.single(len(payload))) + 1))
    except zstandard.ZstdError as problem:
        raise FormatError(f"zstd data is damaged: {problem}") from None
    if not known:
        allowance.take(len(payload), len(content))
    elif size != len(content):
        raise FormatError(f"zstd data holds {len(content)} bytes where {size} are declared")
    return content
