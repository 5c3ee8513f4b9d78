"""What the columns of a Parquet file unpack to, by
the headers of their pages, before a page is read.

The file's footer declares sizes as well, but no reader holds a file to
them. Page headers are Thrift's compact protocol (Apache Thrift,
thrift-compact-protocol.md), their fields those of Parquet (parquet.thrift).
"""

import mmap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import FormatError, LogError
from ..limits import Input

_MOST_PAGES = 1 << 18
_LONGEST_HEADER = 1 << 16
_DEEPEST = 8
_DATA = 0
_DICTIONARY = 2
_DATA_V2 = 3
_DELTA_BYTE_ARRAY = 7
"""The encoding whose texts repeat the beginning of the one before."""
_TYPE = 1
_UNPACKED = 2
_PACKED = 3
_HEADERS = {_DATA: 5, _DICTIONARY: 7, _DATA_V2: 8}
_VALUES = 1
_ENCODING = {_DATA: 2, _DICTIONARY: 2, _DATA_V2: 4}


@dataclass(frozen=True)
class ParquetLeaf:
    """One column without its groups: values · bytes of
    its pages, and of the largest one · bytes of texts.

    texts_read: at most, where each of a dictionary is read
    once · texts_copied: at most, where each value is a copy.
    """

    values: int = 0
    page_bytes: int = 0
    largest: int = 0
    texts_read: int = 0
    texts_copied: int = 0

    def with_chunk(self, other: "ParquetLeaf") -> "ParquetLeaf":
        """Both together."""
        return ParquetLeaf(
            self.values + other.values,
            self.page_bytes + other.page_bytes,
            max(self.largest, other.largest),
            self.texts_read + other.texts_read,
            self.texts_copied + other.texts_copied,
        )


def list_parquet_leaves(
    path: Path, file: Any, limits: Input, groups: tuple[int, ...] | None = None
) -> Mapping[str, ParquetLeaf]:
    """The leaves of an open ParquetFile in some row groups (None: all), by their dotted names.

    LogError, with the setting, where a page unpacks to more
    than a message may; FormatError for a damaged header.
    """
    found: dict[str, ParquetLeaf] = {}
    about = file.metadata
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        pages = 0
        for group in range(about.num_row_groups) if groups is None else groups:
            row_group = about.row_group(group)
            for number in range(row_group.num_columns):
                column = row_group.column(number)
                chunk, count = _read_column_chunk(path, data, column)
                pages += count
                if pages > _MOST_PAGES:
                    raise LogError(f"{path}: more than {_MOST_PAGES} pages")
                name = column.path_in_schema
                found[name] = found.get(name, ParquetLeaf()).with_chunk(chunk)
    largest = max(found, key=lambda name: found[name].largest, default="")
    if found and found[largest].largest > limits.max_message_mb * 1e6:
        asked = (
            f"type in robot.toml: [input] max_message_mb = {-(-found[largest].largest // 10**6)}"
        )
        raise LogError(
            f"{path}: {largest}: a page of {found[largest].largest} bytes; to read it, {asked}"
        )
    return found


def _read_column_chunk(path: Path, data: mmap.mmap, column: Any) -> tuple[ParquetLeaf, int]:
    """One column of one row group, and the number of its pages."""
    start = column.data_page_offset
    if column.has_dictionary_page and 0 < column.dictionary_page_offset < start:
        start = column.dictionary_page_offset
    end = min(start + column.total_compressed_size, len(data))
    values = 0
    unpacked = 0
    largest = 0
    dictionary = 0
    count = 0
    repeats = False
    at = start
    while 0 <= at < end and values < column.num_values:
        try:
            header, at = _read_thrift_struct(data, at, at + _LONGEST_HEADER)
            kind, size, packed = (int(header[field]) for field in (_TYPE, _UNPACKED, _PACKED))
            about = header.get(_HEADERS.get(kind, -1), {})
            own = int(about.get(_VALUES, 0))
        except (KeyError, TypeError, ValueError, IndexError, AttributeError):
            raise FormatError(
                f"{path}: {column.path_in_schema}: the header of a page is damaged"
            ) from None
        if min(size, packed, own) < 0:
            raise FormatError(
                f"{path}: {column.path_in_schema}: a page of {size} bytes and {own} values"
            )
        at += packed
        count += 1
        unpacked += size
        largest = max(largest, size)
        if kind == _DICTIONARY:
            dictionary = max(dictionary, size)
        elif kind in _HEADERS:
            values += own
            repeats |= about.get(_ENCODING[kind]) == _DELTA_BYTE_ARRAY
        if count > _MOST_PAGES:
            raise LogError(f"{path}: {column.path_in_schema}: more than {_MOST_PAGES} pages")
    texts = unpacked * (1 + values) if repeats else unpacked
    return ParquetLeaf(values, unpacked, largest, texts, texts + values * dictionary), count


def _read_thrift_struct(
    data: mmap.mmap, at: int, end: int, depth: int = 0
) -> tuple[dict[int, Any], int]:
    """A struct of the compact protocol as {field: number or
    struct}, and the place behind it; ValueError if damaged.
    """
    if depth > _DEEPEST:
        raise ValueError("too deep")
    found: dict[int, Any] = {}
    field = 0
    while at < end:
        head = data[at]
        at += 1
        if not head:
            return found, at
        if head >> 4:
            field += head >> 4
        else:
            field, at = _read_thrift_number(data, at)
        found[field], at = _read_thrift_value(data, at, end, head & 15, depth)
    raise ValueError("too long")


def _read_thrift_value(
    data: mmap.mmap, at: int, end: int, kind: int, depth: int
) -> tuple[Any, int]:
    """A value of a type of the compact protocol, and the place behind it."""
    if kind in (1, 2):
        return 2 - kind, at
    if kind in (3, 7):
        return None, at + (1 if kind == 3 else 8)
    if kind in (4, 5, 6):
        return _read_thrift_number(data, at)
    if kind == 8:
        length, at = _read_thrift_varint(data, at)
        return None, at + length
    if kind == 12:
        return _read_thrift_struct(data, at, end, depth + 1)
    raise ValueError(f"type {kind}, which no page header has")


def _read_thrift_number(data: mmap.mmap, at: int) -> tuple[int, int]:
    value, at = _read_thrift_varint(data, at)
    return (value >> 1) ^ -(value & 1), at


def _read_thrift_varint(data: mmap.mmap, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise ValueError("a number of more than 64 bits")


def leaves_under_column(found: Mapping[str, ParquetLeaf], column: str) -> Iterator[ParquetLeaf]:
    """The leaves of a column of the table: itself, or those in its lists and groups."""
    return (leaf for name, leaf in found.items() if f"{name}.".startswith(f"{column}."))
