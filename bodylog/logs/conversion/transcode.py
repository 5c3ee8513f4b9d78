"""Write a log of any container as a new chunked MCAP, one batch of messages at a time."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import FormatError
from ...io import episodes
from ..decode.ros1_to_cdr import Converter, known_definition, make_cdr_converter
from ..encode.cdr import Payloads, merge_payloads
from ..formats import open_log
from ..limits import LIMITS, Input
from ..mcap import opcodes as op
from ..mcap.chunks import heads_at
from ..mcap.encode import (
    MESSAGE_HEAD,
    MessageTable,
    encode_attachment,
    encode_metadata,
    gather_pieces,
)
from ..mcap.prefix import NAME, no_utf8
from ..mcap.record_file import sound_heads
from ..mcap.records import Record, is_mcap
from ..mcap.writer import CHUNK_BYTES, Contents, McapRecordWriter
from ..protocol import Progress, count_progress
from ..records import Array, Batch, Finding, Topic
from ..storage.packed_files import is_packed, unpack_file
from ..topics import PREFIX

PROFILE = "ros2"
LIBRARY = "bodylog"
_PENDING = 4 * CHUNK_BYTES
_FEW = 16
_SHORT = 4096


@dataclass
class _Carrier:
    """One topic in transit: its channel, its converter to
    CDR, and the channel of payloads that cannot be converted.
    """

    topic: Topic
    channel: int
    convert: Converter | None = None
    carried: int = 0
    spare: int | None = None
    unconverted: int = 0


Span = tuple[int, int]
"""First and last log time to keep, int64 ns."""


def write_log_messages(
    source: Path,
    stream: BinaryIO,
    only: Collection[str] | None = None,
    ours: bool = False,
    span: Span | None = None,
    limits: Input = LIMITS,
    progress: Progress | None = None,
) -> tuple[McapRecordWriter, int, tuple[Finding, ...]]:
    """Write the messages of a log (`only` these topics, within `span`) to an unfinished MCAP.

    Topics under `PREFIX` are included only with `ours`.

    Returns the writer, the number of messages, and what could not be
    carried over whole. ROS 1 payloads of bags become CDR where possible.
    Payloads, attachments and metadata of an MCAP stay unchanged.
    """
    with open_log(source, limits=limits) as log:
        writer = McapRecordWriter(stream, Contents())
        findings: list[Finding] = []
        writer.begin(_mcap_profile(source) if is_mcap(source) else PROFILE, LIBRARY)
        wanted = [
            t
            for t in log.topics
            if (ours or not t.name.startswith(PREFIX)) and (only is None or t.name in only)
        ]
        carriers = {
            topic.id: _plan_topic_carrier(writer, topic, log.format, findings) for topic in wanted
        }
        for table in _message_tables(
            count_progress(log.batches(list(carriers)), progress), carriers, writer, span
        ):
            writer.write(table)
        if only is None:
            findings += _copy_attachments_and_metadata(
                episodes.dataset_path(source), writer, ours, limits
            )
        findings += [
            _explain_unconverted_topic(source, c) for c in carriers.values() if c.unconverted
        ]
        return writer, sum(c.carried for c in carriers.values()), (*log.findings, *findings)


def _plan_topic_carrier(
    writer: McapRecordWriter, topic: Topic, container: str, findings: list[Finding]
) -> _Carrier:
    kind = topic.type
    encoding = topic.encoding
    definition = topic.definition
    form = topic.definition_encoding
    convert = None
    if container != "mcap" and topic.encoding == "ros1":
        try:
            convert, definition = make_cdr_converter(topic)
            encoding = "cdr"
            form = "ros2msg"
        except FormatError as problem:
            findings.append(
                Finding(
                    "warning", f"{problem}; its messages stay ROS 1, which ROS 2 tools do not read"
                )
            )
            return _Carrier(topic, keep_payloads(writer, topic))
    if container != "mcap" and not definition and convert is None:
        known = known_definition(kind)
        form = "ros2msg"
        definition = known or b""
        if known is None:
            text = (
                f"topic {topic.name}: the log has no definition of {kind}; its messages stay "
                "without one"
            )
            findings.append(Finding("warning", text))
    if topic.encoding == "ros1" and convert is None:
        return _Carrier(topic, keep_payloads(writer, topic))
    return _Carrier(
        topic, writer.topic(topic.name, kind, encoding, definition, form, topic.metadata), convert
    )


def keep_payloads(writer: McapRecordWriter, topic: Topic) -> int:
    """A channel for unchanged payloads; ROS 1 writes types without /msg/."""
    ros1 = topic.encoding == "ros1"
    kind = topic.type.replace("/msg/", "/") if ros1 else topic.type
    form = topic.definition_encoding or ("ros1msg" if ros1 else "ros2msg")
    return writer.topic(topic.name, kind, topic.encoding, topic.definition, form, topic.metadata)


def _message_tables(
    batches: Iterable[Batch],
    carriers: Mapping[int, _Carrier],
    writer: McapRecordWriter,
    span: Span | None,
) -> Iterator[MessageTable]:
    """Batches in groups of a few MiB, each in order of log time."""
    pending: list[MessageTable] = []
    size = 0
    for batch in _split_large_batches(
        batches if span is None else _batches_within_span(batches, span)
    ):
        pending.append(_copy_batch_messages(batch, carriers[batch.topic_id], writer))
        size += pending[-1].data[0].size
        if size >= _PENDING:
            yield _merge_by_log_time(pending)
            pending = []
            size = 0
    if pending:
        yield _merge_by_log_time(pending)


def _batches_within_span(batches: Iterable[Batch], span: Span) -> Iterator[Batch]:
    """The messages logged within a span."""
    for batch in batches:
        rows = np.flatnonzero((batch.log_ns >= span[0]) & (batch.log_ns <= span[1]))
        if len(rows):
            yield Batch(
                batch.topic_id,
                batch.log_ns[rows],
                batch.data,
                batch.offset[rows],
                batch.length[rows],
            )


def _split_large_batches(batches: Iterable[Batch]) -> Iterator[Batch]:
    """The batches, split where they hold more than a few MiB."""
    for batch in batches:
        full = np.cumsum(batch.length) // _PENDING
        cuts = [0, *(np.flatnonzero(np.diff(full)) + 1).tolist(), len(full)]
        for rows in map(slice, cuts, cuts[1:]):
            yield Batch(
                batch.topic_id,
                batch.log_ns[rows],
                batch.data,
                batch.offset[rows],
                batch.length[rows],
            )


def _copy_batch_messages(batch: Batch, carrier: _Carrier, writer: McapRecordWriter) -> MessageTable:
    """A batch as messages of the new file, with bytes of their own."""
    count = len(batch.log_ns)
    channel = np.full(count, carrier.channel)
    sequence, publish_ns = _sequence_and_publish_times(batch, carrier)
    if carrier.convert is None:
        data, offset = gather_pieces(batch.data, batch.offset, batch.length)
        length = batch.length
    else:
        data, offset, length = _convert_payloads(batch, carrier, channel, writer)
    carrier.carried += count
    return MessageTable(channel, sequence, batch.log_ns, publish_ns, (data,), offset, length)


def _sequence_and_publish_times(batch: Batch, carrier: _Carrier) -> tuple[Array, Array]:
    """Sequence numbers and publish times: from the
    record heads of an MCAP's batch; others have none.
    """
    start = batch.offset - MESSAGE_HEAD
    if len(start) and start.min() >= 0:
        heads = heads_at(batch.data, start)
        if (heads["opcode"] == op.MESSAGE).all() and (heads["log"] == batch.log_ns).all():
            return heads["sequence"], heads["publish"]
    return carrier.carried + np.arange(len(batch.log_ns)), batch.log_ns


def _convert_payloads(
    batch: Batch, carrier: _Carrier, channel: Array, writer: McapRecordWriter
) -> tuple[Array, Array, Array]:
    """The payloads as CDR; one that contradicts its
    definition stays ROS 1, on a channel of its own.
    """
    assert carrier.convert is not None
    left, parts = _convert_same_layout(batch, carrier.convert)
    single: list[bytes | memoryview] = []
    for i in left.tolist():
        payload = batch.data[batch.offset[i] : batch.offset[i] + batch.length[i]].data
        try:
            single.append(carrier.convert(payload))
        except FormatError:
            carrier.spare = carrier.spare or keep_payloads(writer, carrier.topic)
            carrier.unconverted += 1
            channel[i] = carrier.spare
            single.append(bytes(payload))
    length = np.array([len(part) for part in single], np.int64)
    parts.append(
        (
            left,
            Payloads(np.frombuffer(b"".join(single), np.uint8), np.cumsum(length) - length, length),
        )
    )
    merged = merge_payloads(parts, len(batch.log_ns))
    return merged.data, merged.offset, merged.length


def _convert_same_layout(
    batch: Batch, convert: Converter
) -> tuple[Array, list[tuple[Array, Payloads]]]:
    """Short messages of equal length and layout as CDR, group by group, and the remaining rows."""
    left = np.ones(len(batch.log_ns), bool)
    parts = []
    sizes, counts = np.unique(batch.length, return_counts=True)
    for size in sizes[(counts >= _FEW) & (sizes <= _SHORT)].tolist():
        rows = np.flatnonzero(batch.length == size)
        while len(rows) >= _FEW:
            try:
                same, out = convert.convert_same_layout(
                    batch.data[batch.offset[rows, None] + np.arange(size)]
                )
            except FormatError:
                break
            width = np.full(len(out), out.shape[1])
            parts.append(
                (rows[same], Payloads(out.reshape(-1), np.arange(len(out)) * out.shape[1], width))
            )
            left[rows[same]] = False
            rows = rows[~same] if same.sum() >= _FEW else rows[:0]
    return np.flatnonzero(left), parts


def _explain_unconverted_topic(source: Path, carrier: _Carrier) -> Finding:
    name = carrier.topic.name
    text = (
        f"{source}: topic {name}: {carrier.unconverted} of {carrier.carried} messages contradict "
        "their definition"
    )
    return Finding("warning", f"{text}; they stay ROS 1, which ROS 2 tools do not read")


def _merge_by_log_time(parts: list[MessageTable]) -> MessageTable:
    shift = np.cumsum([0, *(part.data[0].size for part in parts)])
    log_ns = np.concatenate([part.log_ns for part in parts])
    order = np.argsort(log_ns, kind="stable")
    return MessageTable(
        np.concatenate([part.channel for part in parts])[order],
        np.concatenate([part.sequence for part in parts])[order],
        log_ns[order],
        np.concatenate([part.publish_ns for part in parts])[order],
        tuple(part.data[0] for part in parts),
        np.concatenate([part.offset + start for part, start in zip(parts, shift, strict=False)])[
            order
        ],
        np.concatenate([part.length for part in parts])[order],
    )


def _mcap_profile(source: Path) -> str:
    """The profile of an MCAP; empty when its header is damaged."""
    for file, head in sound_heads(source):
        with suppress(FormatError):
            return str(file.fields(head).fields["profile"]) if head.opcode == op.HEADER else ""
        break
    return ""


def _copy_attachments_and_metadata(
    source: Path, writer: McapRecordWriter, ours: bool, limits: Input
) -> list[Finding]:
    """Copy attachments and metadata of an MCAP, compressed
    or in a folder, up to its first damage; returns losses.
    """
    if source.is_dir():
        members = sorted(
            path for path in source.iterdir() if ".mcap" in path.suffixes and path.is_file()
        )
        return [
            finding
            for member in members
            for finding in _copy_attachments_and_metadata(member, writer, ours, limits)
        ]
    with source.open("rb") as stream:
        packed = is_packed(stream.read(4))
    if packed:
        return unpack_file(
            source,
            lambda inner: _copy_attachments_and_metadata(inner, writer, ours, limits),
            limits,
        )
    lost = []
    for file, head in sound_heads(source):
        if head.opcode in (op.ATTACHMENT, op.METADATA):
            try:
                _keep_extra(file.fields(head), file.record(head), writer, ours)
            except FormatError as problem:
                lost.append(
                    Finding(
                        "lost", f"{source}: the record at byte {head.start} is left out: {problem}"
                    )
                )
    return lost


def _keep_extra(record: Record, raw: bytes, writer: McapRecordWriter, ours: bool) -> None:
    """Copy an attachment or metadata record; text that
    is not UTF-8 is written as far as it can be decoded.
    """
    if record.opcode == op.ATTACHMENT:
        writer.keep_attachment(
            encode_attachment(record.fields) if no_utf8(record) else raw, record.fields
        )
    elif ours or record.fields["name"] != NAME:
        name = record.fields["name"]
        pairs = record.fields["metadata"]
        writer.keep_metadata(name, encode_metadata(name, pairs) if no_utf8(record) else raw)
