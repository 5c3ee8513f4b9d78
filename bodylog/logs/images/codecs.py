"""Decode JPEG, PNG and WebP to BGR: check sizes before
allocation, suppress the libraries' own messages.
"""

import math
import os
import re
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from threading import Lock
from typing import Any
from zlib import crc32

import numpy as np

from ...errors import FormatError
from ..limits import LIMITS
from ..records import Array

_PNG = b"\x89PNG\r\n\x1a\n"
_NEEDED = (b"IHDR", b"PLTE", b"IDAT")
_EOI = b"\xff\xd9"
_TAIL = 64
_STDERR = Lock()
_SILENT = 0
"""OpenCV's log level for no output."""
"""Held while standard error is another file."""
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


def decode_image(data: memoryview, form: str, k: int, mpx: float = LIMITS.max_image_mpx) -> Array:
    """Decode an image's bytes to (H/k, W/k, 3) uint8
    BGR; FormatError, naming its `form`, if that fails.
    """
    height, width, jpeg = _read_image_size(data[: 1 << 16], form)
    check_size(height, width, mpx)
    image = _decode_jpeg(data, height, width, k) if jpeg else None
    if image is None:
        image = _decode_any(data, form, k if jpeg else 1)
    return image if jpeg or k == 1 else _shrink_image(image, k)


def check_size(height: int, width: int, mpx: float) -> None:
    """FormatError, naming the setting, for an image
    without pixels, or with more than `mpx` million.
    """
    if height * width <= 0:
        raise FormatError(f"an image of {width} x {height} pixels")
    if height * width > mpx * 1e6:
        asked = f"type in robot.toml: [input] max_image_mpx = {math.ceil(height * width / 1e6)}"
        raise FormatError(
            f"an image of {width} x {height} pixels, more than {mpx:g} million; {asked}"
        )


def _decode_jpeg(data: memoryview, height: int, width: int, k: int) -> Array | None:
    """Decode a JPEG to the same bytes as OpenCV in 7/8 of its time; None if OpenCV must decide.

    For damaged codes before a complete end OpenCV gives the same, with a message on standard error.
    """
    import simplejpeg

    least = {"min_height": -(-height // k), "min_width": -(-width // k)}
    try:
        return np.asarray(simplejpeg.decode_jpeg(data, "BGR", **least))
    except ValueError as error:
        if not str(error).startswith("Corrupt JPEG data") or _EOI not in bytes(data[-_TAIL:]):
            return None
    with suppress(ValueError):
        return np.asarray(simplejpeg.decode_jpeg(data, "BGR", strict=False, **least))
    return None


def _decode_any(data: memoryview, form: str, k: int) -> Array:
    import cv2

    if data[:8] == _PNG:
        _check_png(data, form)
    home: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 5, or 4
    home.setLogLevel(_SILENT)
    flag = getattr(cv2, f"IMREAD_REDUCED_COLOR_{k}") if k > 1 else cv2.IMREAD_COLOR
    try:
        with _silent_stderr() if bytes(data[:2]) == b"\xff\xd8" else nullcontext():
            image = cv2.imdecode(
                np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION
            )
    except cv2.error as error:
        raise FormatError(
            f"a {form or 'compressed'} image of {len(data)} bytes: {error.err}"
        ) from None
    if image is None:
        raise FormatError(f"a {form or 'compressed'} image of {len(data)} bytes cannot be decoded")
    return np.asarray(image)


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Suppress libjpeg's messages on damaged images, which it writes to standard error itself."""
    with _STDERR, ExitStack() as after:
        try:
            kept = os.dup(2)
            nowhere = os.open(os.devnull, os.O_WRONLY)
        except OSError:  # there is no standard error
            yield
            return
        after.callback(os.close, kept)
        after.callback(os.close, nowhere)
        after.callback(os.dup2, kept, 2)
        os.dup2(nowhere, 2)
        yield


def _check_png(data: memoryview, form: str) -> None:
    """FormatError where a chunk that decoding needs is truncated or fails its checksum."""
    at = len(_PNG)
    name = b""
    while name != b"IEND":
        length, name = (
            struct.unpack_from(">I4s", data, at) if at + 8 <= len(data) else (len(data), b"")
        )
        end = at + 12 + length
        if end > len(data):
            raise FormatError(f"a {form or 'compressed'} image of {len(data)} bytes is cut off")
        if name in _NEEDED and crc32(data[at + 4 : end - 4]) != int.from_bytes(
            data[end - 4 : end], "big"
        ):
            raise FormatError(
                f"a {form or 'compressed'} image whose chunk {name.decode()} fails its checksum"
            )
        at = end


def _shrink_image(image: Array, k: int) -> Array:
    """The means of k by k pixels (H/k, W/k, 3), as JPEG
    gives them; a remainder at right and bottom is dropped.
    """
    import cv2

    height = max(1, image.shape[0] // k)
    width = max(1, image.shape[1] // k)
    return np.asarray(
        cv2.resize(image[: k * height, : k * width], (width, height), interpolation=cv2.INTER_AREA)
    )


def _read_image_size(begins: memoryview, form: str) -> tuple[int, int, bool]:
    """Height, width and whether it is JPEG, from an image's first bytes."""
    head = bytes(begins[:32])
    try:
        if head[:2] == b"\xff\xd8":
            return (*_jpeg_size(begins), True)
        if head[:8] == _PNG:
            width, height = struct.unpack_from(">II", head, 16)
            return height, width, False
        if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
            return (*_webp_size(head), False)
    except (struct.error, IndexError):
        raise FormatError(f"a {form or 'compressed'} image whose header is cut off") from None
    raise FormatError(
        f"format {form!r} beginning with {head[:4].hex() or 'nothing'}; can read jpeg, png and webp"
    )


def _jpeg_size(head: memoryview) -> tuple[int, int]:
    pos = 2
    while True:
        marker, length = struct.unpack_from(">HH", head, pos)
        if marker < 0xFF00:
            raise FormatError(f"a jpeg image with {marker:04x} where a marker belongs")
        if 0xFFC0 <= marker <= 0xFFCF and marker not in (0xFFC4, 0xFFC8, 0xFFCC):
            height, width = struct.unpack_from(">HH", head, pos + 5)
            return height, width
        pos += 1 if marker == 0xFFFF else 2 + length


def _webp_size(head: bytes) -> tuple[int, int]:
    if head[12:16] == b"VP8X":
        return int.from_bytes(head[27:30], "little") + 1, int.from_bytes(head[24:27], "little") + 1
    if head[12:16] == b"VP8L":
        bits = struct.unpack_from("<I", head, 21)[0]
        return (bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1
    width, height = struct.unpack_from("<HH", head, 26)
    return height & 0x3FFF, width & 0x3FFF


def stated_size(data: memoryview) -> tuple[int, int]:
    """Height and width of a BMP, TIFF or PNM image, the largest stated; FormatError for others."""
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
