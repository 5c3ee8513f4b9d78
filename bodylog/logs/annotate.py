"""Write what we found beside what was recorded: the log's own bytes are copied as they are, ours follow."""

import os
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import FormatError, LogError, UsageError
from ..files import replacing
from ..types import Finding, Outgoing
from .append import NAME, Base, is_mcap, keepable, messages
from .mcap_write import Messages
from .rivals import apart
from .transcode import LIBRARY, PROFILE, carry
from .write import Contents, Writer

_BLOCK = 1 << 20
_PIECE = 64 << 20


def annotate(
    source: Path,
    outgoing: Sequence[Outgoing],
    metadata: Mapping[str, str],
    out: Path,
    only: Collection[str] | None = None,
) -> tuple[Finding, ...]:
    """`out` becomes an MCAP with all that is in `source`, the messages given, and a metadata record `bodylog`.

    A chunked MCAP is copied bit for bit; any other log is rewritten, and so is one of which `only` some topics are
    wanted. /bodylog/ topics of an earlier run are replaced.
    Findings name topics that could not be carried over whole. UsageError if `out` is the source, LogError if the copy
    does not hold what it should.
    """
    if out.exists() and source.exists() and out.samefile(source):
        raise UsageError(f"{out}: is the log itself, and a log is never overwritten; type another name after -o")
    with replacing(out) as beside:
        base = _base(source) if only is None else None
        with beside.open("wb") as stream:
            if base is not None:
                kept, findings = _append(source, base, outgoing, metadata, stream)
            else:
                writer, kept, findings = carry(source, stream, only)
                findings += _finish(writer, outgoing, metadata)
        verify(beside, kept + sum(len(o.log_ns) for o in outgoing), out)
    return findings


def write(outgoing: Sequence[Outgoing], metadata: Mapping[str, str], out: Path) -> None:
    """`out` becomes an MCAP of the messages given and a metadata record `bodylog`."""
    with replacing(out) as beside:
        with beside.open("wb") as stream:
            writer = Writer(stream, Contents())
            writer.begin(PROFILE, LIBRARY)
            _finish(writer, outgoing, metadata)
        verify(beside, sum(len(o.log_ns) for o in outgoing), out)


def add(writer: Writer, outgoing: Sequence[Outgoing]) -> None:
    """Topics with their messages in order of log time."""
    numbers = [writer.topic(o.topic, o.type, o.encoding, o.definition, o.definition_encoding, {}) for o in outgoing]
    if outgoing:
        writer.write(_table(outgoing, numbers))


def _base(source: Path) -> Base | None:
    """What can be kept of `source` as it is; None when it must be rewritten."""
    try:
        return keepable(source) if is_mcap(source) else None
    except FormatError:
        return None


def _append(
    source: Path, base: Base, outgoing: Sequence[Outgoing], metadata: Mapping[str, str], stream: BinaryIO
) -> tuple[int, tuple[Finding, ...]]:
    """Copy what can be kept and, meanwhile, write the rest behind it; how many messages were kept, and remarks."""
    kept = sum(base.contents.counts.values())
    with source.open("rb") as original, ThreadPoolExecutor(2) as pool:
        copying = pool.submit(_copy, original.fileno(), stream.fileno(), base.end, pool)
        stream.seek(base.end)
        findings = _finish(Writer(stream, base.contents, base.end, base.crc), outgoing, metadata)
        copying.result()
    return kept, findings


def _finish(writer: Writer, outgoing: Sequence[Outgoing], metadata: Mapping[str, str]) -> tuple[Finding, ...]:
    readable, findings = apart(outgoing, writer.contents.schemas.values())
    add(writer, readable)
    writer.about(NAME, metadata)
    writer.finish()
    return findings


def _copy(source: int, target: int, size: int, pool: ThreadPoolExecutor) -> None:
    """The first `size` bytes, by the kernel where it can; what is copied goes to the disk while the rest follows."""
    done = 0
    flushes: list[Future[None]] = []
    move = _by_kernel if hasattr(os, "copy_file_range") else _by_hand
    while done < size:
        count = move(source, target, min(_PIECE, size - done), done)
        if not count and move is _by_hand:
            raise LogError(f"the log ended at byte {done} of {size} while it was copied; was it still being recorded?")
        move = move if count else _by_hand  # which takes over where the kernel stopped
        done += count
        if done // _PIECE > len(flushes):
            flushes.append(pool.submit(os.fsync, target))
    for flush in flushes:
        flush.result()


def _by_kernel(source: int, target: int, size: int, at: int) -> int:
    """How many bytes were copied; none on another file system, or one that cannot."""
    try:
        return os.copy_file_range(source, target, size, at, at)
    except OSError:
        return 0


def _by_hand(source: int, target: int, size: int, at: int) -> int:
    block = os.pread(source, min(_BLOCK, size), at)
    return os.pwrite(target, block, at)


def _table(outgoing: Sequence[Outgoing], numbers: Sequence[int]) -> Messages:
    counts = [len(o.log_ns) for o in outgoing]
    shift = np.cumsum([0, *(o.data.size for o in outgoing)])
    log_ns = np.concatenate([o.log_ns for o in outgoing])
    order = np.argsort(log_ns, kind="stable")
    return Messages(
        channel=np.repeat(numbers, counts)[order],
        sequence=np.concatenate([np.arange(count) for count in counts])[order],
        log_ns=log_ns[order],
        publish_ns=log_ns[order],
        data=tuple(o.data for o in outgoing),
        offset=np.concatenate([o.offset + start for o, start in zip(outgoing, shift, strict=False)])[order],
        length=np.concatenate([o.length for o in outgoing])[order],
    )


def verify(beside: Path, expected: int, out: Path) -> None:
    """Open what was written and count it by its message indexes."""
    try:
        found = messages(beside)
    except FormatError as problem:
        raise LogError(f"{out}: was not written soundly ({problem}); is the disk full?") from None
    if found != expected:
        raise LogError(f"{out}: holds {found} messages where {expected} were written; is the disk full?")
