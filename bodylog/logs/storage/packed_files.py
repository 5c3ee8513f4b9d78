"""Compression of whole log files (zstd, lz4) and of single messages (zstd, in rosbag2)."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from ...errors import FormatError, LogError
from ...io.temporary import create_scratch_folder
from ..diagnostics import Diagnostics
from ..limits import LIMITS, Input
from ..records import Array, Batch, Topic
from .compression import Allowance, unpack_zstd

ZSTD = b"\x28\xb5\x2f\xfd"
"""The magic of a zstd frame; no CDR payload begins with it."""

_MARGIN = 256 << 20
_HEAD = 32
_PIECE = 128 << 10
"""Size of a zstd block: a damaged block gives no data."""

_TOGETHER = 16 << 20
"""Bytes to decompress together, unless one message is longer."""

Opened = TypeVar("Opened")


def _iterate_zstd_content(stream: BinaryIO) -> Iterator[bytes]:
    """The content of a zstd file in pieces; FormatError at damage."""
    import zstandard

    reader = zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True)
    try:
        while piece := reader.read(_PIECE):
            yield piece
    except zstandard.ZstdError as problem:
        raise FormatError(f"zstd data is damaged: {problem}") from None


def _iterate_lz4_content(stream: BinaryIO) -> Iterator[bytes]:
    """The content of a file of lz4 frames in pieces; FormatError at damage."""
    from lz4.frame import LZ4FrameDecompressor

    unpacker: Any = LZ4FrameDecompressor()
    packed = stream.read(_PIECE)
    while packed or not unpacker.needs_input:
        try:
            piece = unpacker.decompress(packed, _PIECE)
        except RuntimeError as problem:
            raise FormatError(f"lz4 data is damaged: {problem}") from None
        if piece:
            yield piece
        elif not packed:
            return
        if unpacker.eof:
            packed = unpacker.unused_data or stream.read(_PIECE)
            unpacker = LZ4FrameDecompressor()
        else:
            packed = stream.read(_PIECE) if unpacker.needs_input else b""


_PACKED: Mapping[bytes, tuple[str, Callable[[BinaryIO], Iterator[bytes]]]] = {
    ZSTD: ("zstd", _iterate_zstd_content),
    b"\x04\x22\x4d\x18": ("lz4", _iterate_lz4_content),
}
"""Name of a file's compression and how to undo it, by the first bytes."""


def is_packed(first: bytes) -> bool:
    """Whether a file that begins with these bytes is compressed as a whole."""
    return first[:4] in _PACKED


def unpack_file(
    path: Path,
    use: Callable[[Path], Opened],
    limits: Input = LIMITS,
    check: Callable[[bytes], object] = lambda first: None,
) -> Opened:
    """Decompress a file to a temporary file and call `use`
    on it; LogError when disk space or limits do not suffice.

    `check` sees the first bytes and may reject them before the rest is decompressed.
    """
    with create_scratch_folder() as folder:
        inner = folder / path.stem
        from shutil import disk_usage

        _unpack_file(path, inner, disk_usage(folder).free - _MARGIN, limits, check)
        return use(inner)


def _unpack_file(
    path: Path, inner: Path, limit: int, limits: Input, check: Callable[[bytes], object]
) -> None:
    written = 0
    packed = path.stat().st_size
    allowance = Allowance(path, limits)
    with path.open("rb") as stream, inner.open("wb") as target:
        form, pieces = _PACKED[stream.read(4)]
        stream.seek(0)
        damage = f"{form} data is damaged: nothing comes out of its {packed} bytes"
        try:
            for piece in pieces(stream):
                if not written:
                    check(piece[:_HEAD])
                written += len(piece)
                allowance.check(packed, written)
                if written > limit:
                    room = f"the {max(0, limit)} bytes free in {inner.parent.parent}"
                    raise LogError(
                        f"{path}: unpacked it takes more than {room}; name a larger folder "
                        "in TMPDIR"
                    )
                target.write(piece)
        except FormatError as problem:
            damage = str(problem)
    if not written:
        raise LogError(f"{path}: {damage}; copy it again")


def decompress_messages(
    batches: Iterable[Batch], topics: tuple[Topic, ...], diagnostics: Diagnostics
) -> Iterator[Batch]:
    """The batches, with CDR payloads that rosbag2 compressed one by one decompressed."""
    allowance = Allowance(diagnostics.path, diagnostics.limits)
    cdr = {topic.id for topic in topics if topic.encoding == "cdr"}
    for batch in batches:
        first = batch.data[batch.offset[0] : batch.offset[0] + 4].tobytes()
        if first == ZSTD and batch.topic_id in cdr:
            yield from _decompress_batch_parts(batch, diagnostics, allowance)
        elif len(batch.length):
            yield batch


def _decompress_batch_parts(
    batch: Batch, diagnostics: Diagnostics, allowance: Allowance
) -> Iterator[Batch]:
    """The batch decompressed, in parts of some megabytes, to limit memory."""
    kept: list[int] = []
    payloads: list[bytes] = []
    size = 0
    for i, payload in enumerate(_batch_payload_views(batch)):
        try:
            payloads.append(unpack_zstd(payload, allowance))
            kept.append(i)
            size += len(payloads[-1])
        except FormatError as problem:
            diagnostics.add_loss(
                int(batch.offset[i]),
                len(payload),
                1,
                0.0,
                f"a message compressed on its own: {problem}",
            )
        if size > _TOGETHER:
            yield _join_payloads(batch, kept, payloads)
            kept = []
            payloads = []
            size = 0
    if kept:
        yield _join_payloads(batch, kept, payloads)


def _join_payloads(batch: Batch, kept: list[int], payloads: list[bytes]) -> Batch:
    length = np.array([len(payload) for payload in payloads], np.int64)
    data: Array = np.frombuffer(payloads[0] if len(payloads) == 1 else b"".join(payloads), np.uint8)
    return replace(
        batch,
        log_ns=batch.log_ns[kept],
        data=data,
        offset=np.cumsum(length) - length,
        length=length,
    )


def _batch_payload_views(batch: Batch) -> Iterator[memoryview]:
    for start, size in zip(batch.offset.tolist(), batch.length.tolist(), strict=True):
        yield batch.data.data[start : start + size]
