"""MCAP records as bytes, one function each (https://mcap.dev/spec), and message records in bulk."""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from isal.isal_zlib import crc32

from ..records import Array
from . import opcodes as op
from .records import HEAD

_MESSAGE = np.dtype(
    [
        ("opcode", "u1"),
        ("size", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_ns", "<u8"),
        ("publish_ns", "<u8"),
    ]
)
MESSAGE_HEAD = _MESSAGE.itemsize


@dataclass(frozen=True, eq=False)
class MessageTable:
    """n messages of any channels: channel, sequence,
    log_ns, publish_ns (n,), payload i in data at offset[i].

    Offsets count through the concatenated arrays of `data`; no payload spans two of them.
    """

    channel: Array
    sequence: Array
    log_ns: Array
    publish_ns: Array
    data: tuple[Array, ...]
    offset: Array
    length: Array


def encode_string(text: str) -> bytes:
    """A length-prefixed UTF-8 string."""
    raw = text.encode(errors="backslashreplace")
    return struct.pack("<I", len(raw)) + raw


def encode_string_map(pairs: Mapping[str, str]) -> bytes:
    """A length-prefixed map of strings, in key order."""
    body = b"".join(encode_string(key) + encode_string(pairs[key]) for key in sorted(pairs))
    return struct.pack("<I", len(body)) + body


def encode_record(opcode: int, *parts: bytes) -> bytes:
    """Opcode, length, content."""
    return HEAD.pack(opcode, sum(map(len, parts))) + b"".join(parts)


def encode_header(profile: str, library: str) -> bytes:
    """The file's first record."""
    return encode_record(op.HEADER, encode_string(profile), encode_string(library))


def encode_schema(number: int, name: str, encoding: str, definition: bytes) -> bytes:
    """A message definition."""
    return encode_record(
        op.SCHEMA,
        struct.pack("<H", number),
        encode_string(name),
        encode_string(encoding),
        struct.pack("<I", len(definition)),
        definition,
    )


def encode_channel(
    number: int, schema_id: int, topic: str, encoding: str, metadata: Mapping[str, str]
) -> bytes:
    """A topic."""
    return encode_record(
        op.CHANNEL,
        struct.pack("<HH", number, schema_id),
        encode_string(topic),
        encode_string(encoding),
        encode_string_map(metadata),
    )


def encode_metadata(name: str, pairs: Mapping[str, str]) -> bytes:
    """A named map of strings."""
    return encode_record(op.METADATA, encode_string(name), encode_string_map(pairs))


def metadata_index(offset: int, length: int, name: str) -> bytes:
    """Where a metadata record is."""
    return encode_record(op.METADATA_INDEX, struct.pack("<QQ", offset, length), encode_string(name))


def encode_attachment(fields: Mapping[str, Any]) -> bytes:
    """An attachment record with the `fields` of another log's attachment, and a new CRC-32."""
    data = bytes(fields["data"])
    body = struct.pack("<QQ", fields["log_time"], fields["create_time"]) + encode_string(
        fields["name"]
    )
    body += encode_string(fields["media_type"]) + struct.pack("<Q", len(data)) + data
    return encode_record(op.ATTACHMENT, body, struct.pack("<I", crc32(body)))


def attachment_index(offset: int, length: int, fields: Mapping[str, Any]) -> bytes:
    """The index record of an attachment with these `fields`."""
    numbers = struct.pack(
        "<QQQQQ", offset, length, fields["log_time"], fields["create_time"], len(fields["data"])
    )
    return encode_record(
        op.ATTACHMENT_INDEX,
        numbers,
        encode_string(fields["name"]),
        encode_string(fields["media_type"]),
    )


def encode_chunk_head(
    start_ns: int, end_ns: int, size: int, crc: int, compression: str, stored: bytes
) -> tuple[bytes, int]:
    """The head of a chunk record, to be followed by `stored`, and the whole record's length."""
    head = (
        struct.pack("<QQQI", start_ns, end_ns, size, crc)
        + encode_string(compression)
        + struct.pack("<Q", len(stored))
    )
    return HEAD.pack(op.CHUNK, len(head) + len(stored)) + head, HEAD.size + len(head) + len(stored)


def message_index(number: int, log_ns: Array, offset: Array) -> bytes:
    """Log times of one channel's messages and their offsets in the chunk."""
    pairs = np.empty((len(log_ns), 2), "<u8")
    pairs[:, 0] = log_ns
    pairs[:, 1] = offset
    return encode_record(
        op.MESSAGE_INDEX, struct.pack("<HI", number, pairs.nbytes), pairs.tobytes()
    )


def chunk_index(
    span: tuple[int, int],
    place: tuple[int, int],
    indexes: Mapping[int, int],
    indexes_length: int,
    compression: str,
    sizes: tuple[int, int],
) -> bytes:
    """A chunk's times, place (offset, length), message
    index offsets by channel, and sizes (stored, unpacked).
    """
    offsets = b"".join(struct.pack("<HQ", number, indexes[number]) for number in sorted(indexes))
    return encode_record(
        op.CHUNK_INDEX,
        struct.pack("<QQQQI", *span, *place, len(offsets)),
        offsets,
        struct.pack("<Q", indexes_length),
        encode_string(compression),
        struct.pack("<QQ", *sizes),
    )


def encode_statistics(
    counts: Mapping[int, int], numbers: tuple[int, int, int, int, int], span: tuple[int, int]
) -> bytes:
    """Messages per channel; numbers of (schemas, channels,
    attachments, metadata, chunks); first and last log time.
    """
    pairs = b"".join(struct.pack("<HQ", number, counts[number]) for number in sorted(counts))
    head = struct.pack("<QHIIIIQQI", sum(counts.values()), *numbers, *span, len(pairs))
    return encode_record(op.STATISTICS, head, pairs)


def data_end(crc: int) -> bytes:
    """The end of the data section; crc 0 means: not computed."""
    return encode_record(op.DATA_END, struct.pack("<I", crc))


def encode_messages(table: MessageTable) -> tuple[Array, Array]:
    """All message records concatenated as (bytes,) uint8, and where each begins (n,)."""
    size = table.length + MESSAGE_HEAD
    start = np.cumsum(size) - size
    head = np.zeros(len(size), _MESSAGE)
    head["opcode"] = op.MESSAGE
    head["size"] = size - 9
    head["channel"] = table.channel
    head["sequence"] = table.sequence
    head["log_ns"] = table.log_ns
    head["publish_ns"] = table.publish_ns
    out = np.empty(int(size.sum()), np.uint8)
    _byte_windows(out, MESSAGE_HEAD)[start] = head.view(f"V{MESSAGE_HEAD}")
    edges = np.cumsum([0, *(data.size for data in table.data)])
    for number, here in group_rows(np.searchsorted(edges, table.offset, "right") - 1):
        if number < len(table.data):  # an empty payload may begin at the very end
            where = table.offset[here] - edges[number]
            _copy_pieces(
                table.data[number], where, out, start[here] + MESSAGE_HEAD, table.length[here]
            )
    return out, start


def group_rows(numbers: Array) -> Iterator[tuple[int, Array]]:
    """The distinct numbers of (n,), each below 65,536,
    ascending, with the rows (m,) where each occurs.
    """
    numbers = numbers.astype(np.uint16)
    order = np.argsort(numbers, kind="stable")
    edges = np.flatnonzero(np.diff(numbers[order])) + 1
    for rows in np.split(order, edges) if len(order) else ():
        yield int(numbers[rows[0]]), rows


def gather_pieces(data: Array, offset: Array, length: Array) -> tuple[Array, Array]:
    """Pieces of `data` concatenated (bytes,) uint8, and where each begins (n,)."""
    start = np.cumsum(length) - length
    out = np.empty(int(length.sum()), np.uint8)
    _copy_pieces(data, offset, out, start, length)
    return out, start


def _copy_pieces(source: Array, where: Array, out: Array, to: Array, length: Array) -> None:
    """Copy pieces of `source` into `out`, all pieces of one length at once."""
    equal = bool(len(length)) and length.min() == length.max()
    for size in (length[:1] if equal else np.unique(length)).tolist():
        rows = slice(None) if equal else np.flatnonzero(length == size)
        if size:
            _byte_windows(out, size)[to[rows]] = _byte_windows(source, size)[where[rows]]


def _byte_windows(data: Array, size: int) -> Array:
    """The `size` bytes from every offset (bytes,) of `data`
    as one item each: copied as a block, not byte by byte.
    """
    return np.ndarray(max(0, len(data) - size + 1), f"V{size}", data, 0, (1,))
