"""Write what we found beside what was recorded: the log's own bytes are copied as they are, ours follow."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import FormatError
from ..io.atomic_files import replacing
from ..io.outputs import Output, guard
from ..logs.conversion.transcode import LIBRARY, PROFILE, carry
from ..logs.limits import LIMITS, Input
from ..logs.mcap.encode import MessageTable
from ..logs.mcap.prefix import NAME, Prefix, reusable_prefix
from ..logs.mcap.records import is_mcap
from ..logs.mcap.verification import verify
from ..logs.mcap.writer import Contents, Writer
from ..types import Finding, Outgoing
from .background_copy import Copy
from .schema_conflicts import rename_conflicting


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
    with annotating(source, out, whole=only is None) as under_way:
        under_way.copy()
        findings = under_way.add(outgoing, only)
        under_way.about(metadata)
    return findings


@contextmanager
def annotating(source: Path, out: Path, whole: bool = True, limits: Input = LIMITS) -> Iterator["Annotation"]:
    """`annotate` in steps: the source is read and, where it can stay as it is, copied while the messages are made.

    `add` and `about` are to follow, once each; `copy` may come before, once a core is to spare: what takes no time to
    copy waits for that. Nothing is left of `out` when the block fails.
    """
    guard([source], [Output(out)])
    with replacing(out) as beside:
        base = _base(source) if whole else None
        with Copy(source) if base is None else Copy(source, beside, base.end) as copy, beside.open("r+b") as stream:
            under_way = Annotation(source, base, copy, stream, limits)
            yield under_way
            copy.digest()
        verify(beside, under_way.messages, out)


class Annotation:
    """An annotated log under way."""

    def __init__(self, source: Path, base: Prefix | None, copy: Copy, stream: BinaryIO, limits: Input) -> None:
        """Of `base`, what stays of the source and is being copied; None when all is to be rewritten."""
        self.messages = 0
        self.copy, self.digest = copy.begin, copy.digest
        self._source, self._base, self._stream, self._limits = source, base, stream, limits

    def add(self, outgoing: Sequence[Outgoing], only: Collection[str] | None = None) -> tuple[Finding, ...]:
        """Our messages, behind all of the source's or `only` those of some topics; what could not be carried over."""
        self._writer, kept, findings = self._behind(only)
        readable, more = rename_conflicting(outgoing, self._writer.contents.schemas.values())
        add(self._writer, readable)
        self.messages = kept + sum(len(o.log_ns) for o in outgoing)
        return (*findings, *more)

    def about(self, metadata: Mapping[str, str]) -> None:
        """How it was made, and the end of the file."""
        self._writer.about(NAME, metadata)
        self._writer.finish()

    def _behind(self, only: Collection[str] | None) -> tuple[Writer, int, tuple[Finding, ...]]:
        if self._base is None:
            return carry(self._source, self._stream, only, limits=self._limits)
        end, contents = self._base.end, self._base.contents
        kept = sum(contents.counts.values())
        self._stream.seek(end)
        return Writer(self._stream, contents, end, self._base.crc), kept, ()


def write(outgoing: Sequence[Outgoing], metadata: Mapping[str, str], out: Path) -> None:
    """`out` becomes an MCAP of the messages given and a metadata record `bodylog`."""
    with replacing(out) as beside:
        with beside.open("wb") as stream:
            writer = Writer(stream, Contents())
            writer.begin(PROFILE, LIBRARY)
            add(writer, outgoing)
            writer.about(NAME, metadata)
            writer.finish()
        verify(beside, sum(len(o.log_ns) for o in outgoing), out)


def add(writer: Writer, outgoing: Sequence[Outgoing], about: Mapping[str, Mapping[str, str]] | None = None) -> None:
    """Topics with their messages in order of log time; `about`: metadata of some of them."""
    extra = about or {}
    numbers = [
        writer.topic(o.topic, o.type, o.encoding, o.definition, o.definition_encoding, extra.get(o.topic, {}))
        for o in outgoing
    ]
    if outgoing:
        writer.write(_table(outgoing, numbers))


def _base(source: Path) -> Prefix | None:
    """What can be kept of `source` as it is; None when it must be rewritten."""
    try:
        return reusable_prefix(source) if is_mcap(source) else None
    except FormatError:
        return None


def _table(outgoing: Sequence[Outgoing], numbers: Sequence[int]) -> MessageTable:
    counts = [len(o.log_ns) for o in outgoing]
    shift = np.cumsum([0, *(o.data.size for o in outgoing)])
    log_ns = np.concatenate([o.log_ns for o in outgoing])
    order = np.argsort(log_ns, kind="stable")
    return MessageTable(
        channel=np.repeat(numbers, counts)[order],
        sequence=np.concatenate([np.arange(count) for count in counts])[order],
        log_ns=log_ns[order],
        publish_ns=log_ns[order],
        data=tuple(o.data for o in outgoing),
        offset=np.concatenate([o.offset + start for o, start in zip(outgoing, shift, strict=False)])[order],
        length=np.concatenate([o.length for o in outgoing])[order],
    )
