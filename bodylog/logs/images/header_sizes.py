"""The sizes that BMP, TIFF and PNM images state, read before OpenCV allocates them."""

import re
import struct
from collections.abc import Iterator

from ...errors import FormatError

_PNM = re.compile(rb"P[1-6](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")
_PNM_HEADER = 4096
"""Bytes in which the size of a PNM image must stand; comments before it may be long."""
_BMP_CORE = 12
"""Length of the oldest BMP header, whose sizes have two bytes."""
_TIFF = 42
_BIG_TIFF = 43
_WIDTHS = (256, 322)
_HEIGHTS = (257, 323)
"""TIFF tags: width and height of the image, and of its tiles."""
_INTEGERS = {1: "B", 3: "H", 4: "I", 16: "Q"}
"""TIFF types that a size may have, as `struct` codes."""


def stated_size(data: memoryview) -> tuple[int, int]:
    """Height and width of a BMP, TIFF or PNM image, the largest it states; FormatError for others."""
    head = bytes(data[:4])
    try:
        if head[:2] == b"BM":
            return _bmp_size(data)
        if head[:2] in (b"II", b"MM"):
            return _tiff_size(data, "<" if head[:2] == b"II" else ">")
        if found := _PNM.match(data[:_PNM_HEADER]):
            return int(found[2]), int(found[1])
    except (struct.error, ValueError):
        raise FormatError("an image whose header is cut off or damaged") from None
    raise FormatError(
        f"an image beginning with {head.hex() or 'nothing'}; can read jpeg, png, webp, bmp, "
        "tiff and pnm"
    )


def _bmp_size(data: memoryview) -> tuple[int, int]:
    (length,) = struct.unpack_from("<I", data, 14)
    if length == _BMP_CORE:
        width, height = struct.unpack_from("<HH", data, 18)
        return height, width
    width, height = struct.unpack_from("<ii", data, 18)
    return abs(height), abs(width)  # a negative height: rows from above


def _tiff_size(data: memoryview, order: str) -> tuple[int, int]:
    """The largest height and width of the first directory, of image or tile."""
    (version,) = struct.unpack_from(f"{order}H", data, 2)
    if version == _TIFF:
        (start,) = struct.unpack_from(f"{order}I", data, 4)
        (count,) = struct.unpack_from(f"{order}H", data, start)
        entries = _iterate_directory_entries(data, order, start + 2, count, 12)
    elif version == _BIG_TIFF:
        (start,) = struct.unpack_from(f"{order}Q", data, 8)
        (count,) = struct.unpack_from(f"{order}Q", data, start)
        entries = _iterate_directory_entries(data, order, start + 8, count, 20)
    else:
        raise FormatError(f"a tiff image of version {version}; can read {_TIFF} and {_BIG_TIFF}")
    widths = [0]
    heights = [0]
    for tag, value in entries:
        if tag in _WIDTHS:
            widths.append(value)
        elif tag in _HEIGHTS:
            heights.append(value)
    return max(heights), max(widths)


def _iterate_directory_entries(
    data: memoryview, order: str, start: int, count: int, step: int
) -> Iterator[tuple[int, int]]:
    """Yield tag and value of a directory's integers; the value ends an entry of `step` bytes."""
    for at in range(start, min(start + count * step, len(data)), step):
        tag, kind = struct.unpack_from(f"{order}HH", data, at)
        if kind in _INTEGERS:
            value_at = at + 4 + (step - 4) // 2
            (value,) = struct.unpack_from(f"{order}{_INTEGERS[kind]}", data, value_at)
            yield tag, value
