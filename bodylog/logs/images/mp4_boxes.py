"""How many samples an MP4 declares, read before
FFmpeg makes an entry of some tens of bytes for each.

A box (ISO/IEC 14496-12) is its length, its kind and its content; tables give one size, or one time,
to any number of samples in a few bytes.
"""

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

from ...errors import LogError
from ..limits import Input

_CONTAINERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"moof", b"traf", b"mvex")
_BOXES_A_FRAME = 4
_TRACKS = 4
"""Samples for each image: sound has some fifty a second where images are thirty."""
_MOST_BOXES = 1000
"""Boxes of a file, apart from those of fragments."""
_DEEPEST = 8


def check_samples(path: Path, limits: Input) -> None:
    """LogError where an MP4 declares more samples than a camera may have images; other files pass."""
    if path.stat().st_size < 16:
        return
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[4:8] not in (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip"):
            return
        samples = parts = 0
        for boxes, (kind, start, end) in enumerate(_iterate_boxes(data, 0, len(data), 0)):
            if kind in (b"stsz", b"stz2") and end - start >= 12:
                samples += struct.unpack_from(">I", data, start + 8)[0]
            elif kind == b"trun" and end - start >= 8:
                samples += struct.unpack_from(">I", data, start + 4)[0]
            elif kind == b"elst" and end - start >= 8:
                parts = max(parts, struct.unpack_from(">I", data, start + 4)[0])
            whole = samples * max(parts, 1)
            if (
                whole > _TRACKS * limits.max_frames
                or boxes > _BOXES_A_FRAME * limits.max_frames + _MOST_BOXES
            ):
                asked = f"to read it, type in robot.toml: [input] max_frames = {max(whole, boxes)}"
                raise LogError(
                    f"{path}: its tables declare {whole} samples in {boxes} boxes; {asked}"
                )


def _iterate_boxes(
    data: mmap.mmap, start: int, end: int, depth: int
) -> Iterator[tuple[bytes, int, int]]:
    """Every box between two bytes, and those in it:
    its kind, and where its content begins and ends.
    """
    while start + 8 <= end:
        length, kind = struct.unpack_from(">I4s", data, start)
        head = 8
        if length == 1 and start + 16 <= end:
            length = struct.unpack_from(">Q", data, start + 8)[0]
            head = 16
        last = end if length == 0 else min(start + length, end)
        if last < start + head:
            return
        yield kind, start + head, last
        if kind in _CONTAINERS and depth < _DEEPEST:
            yield from _iterate_boxes(data, start + head, last, depth + 1)
        start = last
