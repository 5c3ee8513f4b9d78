"""Find the next sound record in a damaged MCAP, and the bytes lost before it."""

from collections.abc import Callable, Collection, Iterator

import numpy as np

from ...errors import FormatError
from ..records import Array
from ..storage.compression import NAMES
from ..storage.mmapped import drop_pages, is_zero
from . import opcodes as op
from .chunks import CHUNK_HEAD, MESSAGE_HEAD, chunk_head, follow_messages, heads_of
from .records import FIELDS, HEAD, parse_record

_WINDOW = 1 << 20
_AHEAD = 64 << 20
_IN_CHUNKED = (op.CHUNK, op.MESSAGE_INDEX, op.CHUNK_INDEX)
_CHUNK_FIXED = 40
_LONGEST_END = 64
_LARGEST = 1 << 40
_FEW = 16
_SHORTEST = MESSAGE_HEAD.itemsize - HEAD.size

Found = tuple[int, int, int]
"""A record: opcode, start, length of its body."""


Many = Callable[[Array, int], bool]
"""Takes or declines consecutive messages: where they start (n,) and where they end."""


def iterate_sound_records(
    data: memoryview,
    start: int,
    end: int,
    channels: Collection[int],
    lost: Callable[[int, int], None],
    many: Many = lambda _starts, _end: False,
) -> Iterator[Found]:
    """The records between two bytes; after each damage
    `lost(start, size)` is called and the search resumes.

    Messages that `many` takes in bulk are not yielded.
    """
    at = start
    chunked = None
    singly = start
    held: Found | None = None
    while at < end:
        if at >= singly and data[at] == op.MESSAGE:
            starts, singly = follow_messages(data, at, end)
            if len(starts) > _FEW:
                if held:
                    yield held
                    held = None
                # The last one's length may be wrong; the next record shows it.
                at = int(starts[-1]) if many(starts[:-1], int(starts[-1])) else at
        opcode, length = HEAD.unpack_from(data, at) if end - at >= HEAD.size else (0, 0)
        if (
            opcode == op.MESSAGE and _SHORTEST <= length <= end - at - HEAD.size
        ) or _is_plausible_record(data, at, end):
            if held:
                yield held
            held = (opcode, at, length)
            at += HEAD.size + length
            chunked = chunked or opcode == op.CHUNK or None
            if opcode == op.FOOTER:
                break
            continue
        if chunked is None:
            chunked = _chunks_follow(data, at, min(end, at + _AHEAD))
        low = at if held is None or held[0] == op.CHUNK else held[1] + 1
        found = find_next_record(data, low, end, *_search_targets(chunked, channels))
        begin = at
        if held and found is not None and found < at:  # the length of the record before was wrong
            begin = held[1]
        elif held:
            yield held
        held = None
        at = end if found is None else found
        lost(begin, at - begin)
    if held:
        yield held


def _chunks_follow(data: memoryview, start: int, end: int) -> bool:
    """Whether chunks and their indexes follow a damage,
    even if the file ends inside the first of them.
    """
    if _chunk_like(data, start):
        return True
    for low in range(start, end, _WINDOW):
        if is_zero(data, low, min(end, low + _WINDOW)):
            continue
        heads = heads_of(data[low : min(end, low + _WINDOW + MESSAGE_HEAD.itemsize - 1)])
        likely = (
            (heads["opcode"] == op.CHUNK)
            & (heads["size"] >= _CHUNK_FIXED)
            & (heads["size"] < _LARGEST)
        )
        if any(_chunk_like(data, low + int(at)) for at in np.flatnonzero(likely)):
            return True
    return find_next_record(data, start, end, _IN_CHUNKED, ()) is not None


def _chunk_like(data: memoryview, at: int) -> bool:
    """Whether a chunk begins at a damaged place: at least two marks of its head are present."""
    if len(data) - at < HEAD.size + _CHUNK_FIXED:
        return False
    opcode, length = HEAD.unpack_from(data, at)
    _, _, size, _, letters = CHUNK_HEAD.unpack_from(data, at + HEAD.size)
    name = at + HEAD.size + CHUNK_HEAD.size
    for known in NAMES:
        end = name + len(known)
        if data[name:end] == known.encode():
            packed = int.from_bytes(data[end : end + 8], "little")
            signs = [opcode == op.CHUNK, known != "", length == _CHUNK_FIXED + len(known) + packed]
            signs += [
                known == "" and length == _CHUNK_FIXED + size,
                known == "" and 0 < packed == size,
            ]
            if sum(signs) + (known != "" and letters == len(known)) >= 2:
                return True
    return False


def _search_targets(
    chunked: bool, channels: Collection[int]
) -> tuple[Collection[int], Collection[int]]:
    """Opcodes and channels to search for after damage,
    outside chunks: content of a damaged chunk is unchecked.
    """
    return (
        ((*_IN_CHUNKED, op.DATA_END), ())
        if chunked
        else ((op.SCHEMA, op.CHANNEL, op.DATA_END), channels)
    )


def _is_plausible_record(data: memoryview, at: int, end: int) -> bool:
    if end - at < HEAD.size:
        return False
    opcode, length = HEAD.unpack_from(data, at)
    if opcode == 0 or length > end - at - HEAD.size:
        return False
    if opcode == op.MESSAGE:
        return bool(length >= _SHORTEST)
    try:
        if opcode in (op.DATA_END, op.FOOTER):
            return bool(length <= _LONGEST_END)
        if opcode == op.CHUNK:
            chunk_head(data, at)
        elif opcode in FIELDS:
            parse_record(opcode, data[at + HEAD.size : at + HEAD.size + length])
    except FormatError:
        return False
    return True


def find_next_record(
    data: memoryview, start: int, end: int, opcodes: Collection[int], channels: Collection[int]
) -> int | None:
    """The first byte from `start` where such a record, or
    a message of such a channel, plausibly begins, or None.
    """
    known = np.zeros(1 << 16, bool)
    known[list(channels)] = True
    for low in range(start, end, _WINDOW):
        if is_zero(data, low, min(end, low + _WINDOW)):
            continue
        high = min(end, low + _WINDOW + MESSAGE_HEAD.itemsize - 1)
        for at in _candidate_offsets(data[low:high], end - low, list(opcodes), known):
            if _is_sound(data, low + at, end):
                return low + at
        drop_pages(data, low, high)
    return None


def _candidate_offsets(
    window: memoryview, left: int, opcodes: list[int], known: Array
) -> list[int]:
    heads = heads_of(window)
    opcode = heads["opcode"]
    size = heads["size"]
    likely = np.isin(opcode, opcodes) | (opcode == op.MESSAGE) & (size >= _SHORTEST)
    where = np.flatnonzero(likely & (size >= 0) & (size < left))
    return [int(at) for at in where[(opcode[where] != op.MESSAGE) | known[heads["channel"][where]]]]


def _is_sound(data: memoryview, at: int, end: int) -> bool:
    """Whether a whole record is at `at`, and it is either
    a consistent chunk or followed by another record.
    """
    if not _is_plausible_record(data, at, end):
        return False
    opcode, length = HEAD.unpack_from(data, at)
    after = at + HEAD.size + length
    if opcode == op.CHUNK:
        *_, compression, packed = chunk_head(data, at)
        return compression in NAMES and length == _CHUNK_FIXED + len(compression) + len(packed)
    return after == end or (_is_plausible_record(data, after, end) and data[after] in FIELDS)
