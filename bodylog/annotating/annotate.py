"""Write features and estimates into a copy of a log:
its own bytes are unchanged, the new messages follow.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import FormatError
from ..io.atomic_files import replace_atomically
from ..logs.conversion.transcode import write_log_messages
from ..logs.decode.definitions import parse_definition
from ..logs.limits import LIMITS, Input
from ..logs.mcap import opcodes as op
from ..logs.mcap.encode import MessageTable
from ..logs.mcap.prefix import NAME, Prefix, reusable_prefix
from ..logs.mcap.records import HEAD, is_mcap, parse_record
from ..logs.mcap.verification import verify_message_count
from ..logs.mcap.writer import McapRecordWriter
from ..types import Finding, Outgoing
from .background_copy import Copy

_BORROWED = "foxglove_msgs/"
_OWN = "bodylog_msgs/"
_READ = ("ros1msg", "ros2msg", "ros2idl")


@contextmanager
def open_annotation(
    source: Path, out: Path, whole: bool = True, limits: Input = LIMITS
) -> Iterator["Annotation"]:
    """Write an MCAP `out` with all of `source`, more messages and a metadata record `bodylog`.

    A chunked MCAP is copied byte for byte while the messages are made; other logs, or all if not
    `whole`, are rewritten. Topics of an earlier run are replaced. `out` must not be the source.
    Call `add` and `about` once each. An exception leaves no `out`; LogError if the copy fails
    verification.
    """
    with replace_atomically(out) as beside:
        base = _find_reusable_prefix(source) if whole else None
        with Copy(source) if base is None else Copy(source, beside, base.end) as copy:
            with beside.open("r+b") as stream:
                under_way = Annotation(source, base, copy, stream, limits)
                yield under_way
            copy.digest()
            verify_message_count(beside, under_way.messages, out)


class Annotation:
    """An annotated log in progress."""

    def __init__(
        self, source: Path, base: Prefix | None, copy: Copy, stream: BinaryIO, limits: Input
    ) -> None:
        """`base` is the part of the source that is copied; None to rewrite everything."""
        self.messages = 0
        self.digest = copy.digest
        self._source = source
        self._base = base
        self._stream = stream
        self._limits = limits

    def add(
        self, outgoing: Sequence[Outgoing], only: Collection[str] | None = None
    ) -> tuple[Finding, ...]:
        """Write messages after those of the source, or of `only` some topics of it.

        Findings name topics that are not carried over whole.
        """
        self._writer, kept, findings = self._behind(only)
        readable, more = rename_conflicting(outgoing, self._writer.contents.schemas.values())
        add_topics(self._writer, readable)
        self.messages = kept + sum(len(o.log_ns) for o in outgoing)
        return (*findings, *more)

    def about(self, metadata: Mapping[str, str]) -> None:
        """Write the metadata record and the end of the file."""
        self._writer.about(NAME, metadata)
        self._writer.finish()

    def _behind(
        self, only: Collection[str] | None
    ) -> tuple[McapRecordWriter, int, tuple[Finding, ...]]:
        if self._base is None:
            return write_log_messages(self._source, self._stream, only, limits=self._limits)
        end = self._base.end
        contents = self._base.contents
        kept = sum(contents.counts.values())
        self._stream.seek(end)
        return McapRecordWriter(self._stream, contents, end, self._base.crc), kept, ()


def add_topics(
    writer: McapRecordWriter,
    outgoing: Sequence[Outgoing],
    about: Mapping[str, Mapping[str, str]] | None = None,
) -> None:
    """Write topics with their messages in order of log time; `about`: metadata of some of them."""
    extra = about or {}
    numbers = [
        writer.topic(
            o.topic, o.type, o.encoding, o.definition, o.definition_encoding, extra.get(o.topic, {})
        )
        for o in outgoing
    ]
    if outgoing:
        writer.write(_table_of_outgoing(outgoing, numbers))


def _find_reusable_prefix(source: Path) -> Prefix | None:
    """The part of `source` that can be kept; None if it must be rewritten."""
    try:
        return reusable_prefix(source) if is_mcap(source) else None
    except FormatError:
        return None


def _table_of_outgoing(outgoing: Sequence[Outgoing], numbers: Sequence[int]) -> MessageTable:
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
        offset=np.concatenate(
            [o.offset + start for o, start in zip(outgoing, shift, strict=False)]
        )[order],
        length=np.concatenate([o.length for o in outgoing])[order],
    )


def rename_conflicting(
    outgoing: Sequence[Outgoing], schemas: Iterable[bytes]
) -> tuple[list[Outgoing], tuple[Finding, ...]]:
    """The messages, renamed where the file's Schema
    records define their type differently; and findings.
    """
    theirs = _types_in_schemas(schemas)
    conflicting = {
        o.topic for o in outgoing if o.type.startswith(_BORROWED) and _differs_from_log(o, theirs)
    }
    found = [_rename_borrowed_type(o) if o.topic in conflicting else o for o in outgoing]
    text = (
        "{}: the log has another {}; written as {}, which every reader reads but viewers do not "
        "draw"
    )
    lines = [
        text.format(o.topic, o.type, f.type)
        for o, f in zip(outgoing, found, strict=True)
        if o.topic in conflicting
    ]
    return found, tuple(Finding("warning", line) for line in lines)


def _types_in_schemas(schemas: Iterable[bytes]) -> dict[str, object]:
    types: dict[str, object] = {}
    for raw in schemas:
        fields = parse_record(op.SCHEMA, memoryview(raw)[HEAD.size :]).fields
        if fields["encoding"] in _READ and _BORROWED.encode() in raw:
            try:
                types |= parse_definition(fields["data"], fields["name"], fields["encoding"]).types
            except FormatError:
                continue  # no reader can parse it
    return types


def _differs_from_log(outgoing: Outgoing, theirs: dict[str, object]) -> bool:
    ours = parse_definition(outgoing.definition, outgoing.type, outgoing.definition_encoding).types
    return any(
        theirs.get(name, fields) != fields
        for name, fields in ours.items()
        if name.startswith(_BORROWED)
    )


def _rename_borrowed_type(outgoing: Outgoing) -> Outgoing:
    definition = outgoing.definition.replace(_BORROWED.encode(), _OWN.encode())
    return replace(outgoing, type=outgoing.type.replace(_BORROWED, _OWN), definition=definition)
