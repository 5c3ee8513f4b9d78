"""MCAP records: one table of fields per opcode; every length is checked against its record."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import FormatError
from . import opcodes as op

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""A record's opcode and the length of its body."""

FIELDS: dict[int, tuple[str, str]] = {
    op.HEADER: ("Header", "profile:str library:str"),
    op.FOOTER: ("Footer", "summary_start:u64 summary_offset_start:u64 summary_crc:u32"),
    op.SCHEMA: ("Schema", "id:u16 name:str encoding:str data:bytes"),
    op.CHANNEL: ("Channel", "id:u16 schema_id:u16 topic:str message_encoding:str metadata:texts"),
    op.MESSAGE: ("Message", "channel_id:u16 sequence:u32 log_time:u64 publish_time:u64 data:rest"),
    op.CHUNK: (
        "Chunk",
        "message_start_time:u64 message_end_time:u64 uncompressed_size:u64 "
        "uncompressed_crc:u32 compression:str "
        "records:long",
    ),
    op.MESSAGE_INDEX: ("MessageIndex", "channel_id:u16 records:bytes"),
    op.CHUNK_INDEX: (
        "ChunkIndex",
        "message_start_time:u64 message_end_time:u64 chunk_start_offset:u64 chunk_length:u64 "
        "message_index_offsets:offsets message_index_length:u64 compression:str "
        "compressed_size:u64 "
        "uncompressed_size:u64",
    ),
    op.ATTACHMENT: (
        "Attachment",
        "log_time:u64 create_time:u64 name:str media_type:str data:long crc:u32",
    ),
    op.ATTACHMENT_INDEX: (
        "AttachmentIndex",
        "offset:u64 length:u64 log_time:u64 create_time:u64 data_size:u64 name:str media_type:str",
    ),
    op.STATISTICS: (
        "Statistics",
        "message_count:u64 schema_count:u16 channel_count:u32 attachment_count:u32 "
        "metadata_count:u32 "
        "chunk_count:u32 message_start_time:u64 message_end_time:u64 "
        "channel_message_counts:offsets",
    ),
    op.METADATA: ("Metadata", "name:str metadata:texts"),
    op.METADATA_INDEX: ("MetadataIndex", "offset:u64 length:u64 name:str"),
    op.SUMMARY_OFFSET: ("SummaryOffset", "group_opcode:u8 group_start:u64 group_length:u64"),
    op.DATA_END: ("DataEnd", "data_section_crc:u32"),
}
"""Opcode -> name of the record and its fields in order, each with its kind."""

_CODES = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q"}
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_OFFSET = struct.Struct("<HQ")


def _plan_record_fields(fields: str) -> tuple[tuple[str, tuple[str, ...], struct.Struct], ...]:
    """Fields in order as (kind, names, struct); adjacent numbers are read at once."""
    steps: list[tuple[str, tuple[str, ...], str]] = []
    for name, kind in (field.split(":") for field in fields.split()):
        if kind in _CODES and steps and steps[-1][0] == "numbers":
            steps[-1] = ("numbers", (*steps[-1][1], name), steps[-1][2] + _CODES[kind])
        else:
            steps.append(
                ("numbers" if kind in _CODES else kind, (name,), "<" + _CODES.get(kind, ""))
            )
    return tuple((kind, names, struct.Struct(codes)) for kind, names, codes in steps)


_PLANS = {opcode: _plan_record_fields(fields) for opcode, (_, fields) in FIELDS.items()}


class Record(NamedTuple):
    """One record: opcode, start in its file or chunk, and fields by name."""

    opcode: int
    start: int
    fields: dict[str, Any]

    @property
    def name(self) -> str:
        """The record's name in the MCAP specification."""
        return FIELDS[self.opcode][0]


class _Reader:
    """A cursor over one record's body."""

    def __init__(self, body: memoryview) -> None:
        self._body = body
        self._at = 0

    def take(self, size: int) -> memoryview:
        """The next `size` bytes; FormatError when the record is shorter."""
        if size > len(self._body) - self._at:
            raise FormatError(
                f"a field of {size} bytes in a record with {len(self._body) - self._at} bytes left"
            )
        self._at += size
        return self._body[self._at - size : self._at]

    def read(self, kind: str) -> Any:
        """The next field of that kind."""
        if kind == "rest":
            return bytes(self.take(len(self._body) - self._at))
        if kind == "long":
            return self.take(_U64.unpack(self.take(8))[0])
        content = self.take(_U32.unpack(self.take(4))[0])
        if kind == "str":
            return str(content, "utf-8", "replace")
        if kind == "bytes":
            return bytes(content)
        return _read_string_map(content) if kind == "texts" else _read_offset_map(content)


def _read_string_map(content: memoryview) -> dict[str, str]:
    inner = _Reader(content)
    texts = {}
    while inner._at < len(content):
        name = inner.read("str")
        texts[name] = inner.read("str")
    return texts


def _read_offset_map(content: memoryview) -> dict[int, int]:
    if len(content) % _OFFSET.size:
        raise FormatError(f"a table of {len(content)} bytes whose rows take {_OFFSET.size}")
    return dict(_OFFSET.iter_unpack(content))


def is_mcap(path: Path) -> bool:
    """Whether a file begins with the magic of an MCAP;
    False for a folder or a file that cannot be read.
    """
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def parse_record(opcode: int, body: memoryview, start: int = 0) -> Record:
    """Parse the record in `body`; FormatError when an inner length contradicts it."""
    reader = _Reader(body)
    fields: dict[str, Any] = {}
    for kind, names, numbers in _PLANS[opcode]:
        if kind == "numbers":
            fields.update(zip(names, numbers.unpack(reader.take(numbers.size)), strict=True))
        else:
            fields[names[0]] = reader.read(kind)
    return Record(opcode, start, fields)


def iter_records(data: memoryview, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """(opcode, body start, body length) of the records
    from `start`; FormatError where one extends past `end`.
    """
    at = start
    while at < end:
        if end - at < HEAD.size:
            raise FormatError(
                f"byte {at}: {end - at} bytes where a record header takes {HEAD.size}"
            )
        opcode, length = HEAD.unpack_from(data, at)
        if opcode == 0 or length > end - at - HEAD.size:
            raise FormatError(
                f"byte {at}: opcode {opcode} with {length} bytes; {end - at - HEAD.size} are left"
            )
        yield opcode, at + HEAD.size, length
        at += HEAD.size + length
