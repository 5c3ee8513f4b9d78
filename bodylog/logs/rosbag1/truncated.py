"""The truncated chunk at the end of a ROS 1 bag: cut
by a full disk or a killed copy, or never closed.
"""

import bz2
import struct
from contextlib import suppress
from dataclasses import dataclass

from ...errors import FormatError
from ..storage.compression import STORED
from .records import CHUNK, record_at

_U32 = struct.Struct("<I")
_LZ4 = b"\x04\x22\x4d\x18"
_LONGEST_HEAD = 1 << 16
_ALWAYS = 64 << 20
_RATIO = 255


@dataclass(frozen=True)
class Cut:
    """The rest of a chunk: compression, packed bytes, the
    bytes they expand to at most, and how many are missing.
    """

    compression: str
    packed: memoryview
    most: int
    lacks: int | None = None


def cut_at(data: memoryview, at: int) -> Cut | None:
    """The truncated chunk at byte `at`; None when it is whole, or something else.

    A recorder writes a chunk's length when it closes the chunk; before, the length is 0 and
    uncompressed records follow.
    """
    head = min(len(data) - at, _LONGEST_HEAD)
    with suppress(FormatError, struct.error):
        size = _U32.unpack_from(data, at)[0]
        start = at + 8 + size
        if size > head - 8:
            return None
        length = _U32.unpack_from(data, start - 4)[0]
        record = record_at(memoryview(bytes(data[at : start - 4]) + bytes(4)), 0, start - at)
        compression = str(record.fields.get(b"compression", b""), "ascii", "replace")
        stored = compression in STORED
        if record.op != CHUNK or ((length or stored) and length <= len(data) - start):
            return None
        whole = record.number(b"size")
        packed = data[start:]
        lacks = length - len(packed) if stored and length == whole else None
        return Cut(
            compression, packed, min(whole or _ALWAYS, max(_ALWAYS, _RATIO * len(packed))), lacks
        )
    return None


def decompress_truncated(cut: Cut) -> bytes:
    """Records before the cut, as far as they decompress: bz2 block by block, lz4 byte by byte."""
    if cut.compression == "bz2":
        return _decompress_bz2_start(cut.packed, cut.most)
    return bytes(_decompress_lz4_start(cut.packed, cut.most)) if cut.compression == "lz4" else b""


def _decompress_bz2_start(packed: memoryview, most: int) -> bytes:
    with suppress(OSError, EOFError):
        return bz2.BZ2Decompressor().decompress(packed, max_length=most)
    return b""


def _decompress_lz4_start(packed: memoryview, most: int) -> bytearray:
    """LZ4 frame: https://github.com/lz4/lz4/blob/dev/doc/lz4_Frame_format.md;
    the library gives only whole blocks.
    """
    found = bytearray()
    if packed[:4] != _LZ4 or len(packed) < 7:
        return found
    flags = packed[4]
    at = 7 + (8 if flags & 8 else 0) + (4 if flags & 1 else 0)
    after = 4 if flags & 16 else 0
    while at + 4 <= len(packed) and len(found) < most:
        head = _U32.unpack_from(packed, at)[0]
        size = head & 0x7FFFFFFF
        if not size:
            break
        block = packed[at + 4 : at + 4 + size]
        if head >> 31:
            found += block
        elif not _append_lz4_sequences(block, found, most):
            break
        at += 4 + size + after
    del found[most:]
    return found


def _append_lz4_sequences(block: memoryview, found: bytearray, most: int) -> bool:
    """Append a block of literals and matches to `found`; returns whether it is sound to its end."""
    at = 0
    with suppress(IndexError):
        while len(found) < most:
            token = block[at]
            literals, at = _read_lz4_length(block, at + 1, token >> 4)
            found += block[at : at + literals]
            at += literals
            if at >= len(block):
                return at == len(block)
            offset = block[at] | block[at + 1] << 8
            length, at = _read_lz4_length(block, at + 2, token & 15)
            if not 0 < offset <= len(found):
                return False
            _repeat_match(found, offset, length + 4)
    return False


def _read_lz4_length(block: memoryview, at: int, nibble: int) -> tuple[int, int]:
    """A length, where the nibble 15 means that more bytes follow, and the byte after it."""
    length = nibble
    while nibble == 15:
        length += block[at]
        at += 1
        if block[at - 1] != 255:
            break
    return length, at


def _repeat_match(found: bytearray, offset: int, length: int) -> None:
    start = len(found) - offset
    found += (found[start : start + length] * -(-length // offset))[:length]
