"""Rewrite the sound part of a log as a clean, indexed MCAP."""

from pathlib import Path
from typing import BinaryIO

from ...errors import LogError
from ...io.atomic_files import replace_atomically
from ...io.outputs import Output, guard_outputs
from ..formats import open_log, payload_views
from ..limits import LIMITS, Input
from ..mcap import opcodes as op
from ..mcap.chunks import MESSAGE_HEAD
from ..mcap.encode import encode_attachment
from ..mcap.reader import McapLog
from ..mcap.records import HEAD
from ..mcap.verification import verify_message_count
from ..mcap.writer import Contents, McapRecordWriter
from ..protocol import Log
from ..records import Finding
from .transcode import LIBRARY, keep_payloads

_U64 = 1 << 64
_PROFILES = {"cdr": "ros2", "ros1": "ros1"}


def rewrite_sound_messages(path: Path, out: Path, limits: Input = LIMITS) -> tuple[Finding, ...]:
    """Write the sound messages of `path` to the MCAP `out`
    and return what is wrong; LogError when none is sound.
    """
    guard_outputs([path], [Output(out, "--repair")])
    with open_log(path, limits=limits) as log, replace_atomically(out) as beside:
        with beside.open("wb") as stream:
            written = (
                _rewrite_mcap(log, stream)
                if isinstance(log, McapLog)
                else _rewrite_other_log(log, stream)
            )
        if not written and any(finding.severity == "lost" for finding in log.findings):
            raise LogError(
                f"{path}: nothing in it can be saved; "
                f"{log.findings[-1].text.removeprefix(f'{path}: ')}"
            )
        verify_message_count(beside, written, out)
        return log.findings


def _rewrite_mcap(log: McapLog, stream: BinaryIO) -> int:
    """Copy channels, sequence numbers, publish times,
    attachments and metadata unchanged; returns messages written.
    """
    header = next(log.records(op.HEADER), None)
    writer = McapRecordWriter(stream, Contents(), crc=0)
    writer.begin(header.fields["profile"] if header else "", LIBRARY)
    survey = log.survey
    count = 0
    channels = {}
    for number, record in survey.channels.items():
        fields = record.fields
        schema = survey.schemas.get(fields["schema_id"])
        channels[number] = writer.topic(
            fields["topic"],
            schema.fields["name"] if schema else "",
            fields["message_encoding"],
            schema.fields["data"] if schema else b"",
            schema.fields["encoding"] if schema else "",
            fields["metadata"],
        )
    for content, found in log.messages():
        for start, head in zip(found.starts.tolist(), found.heads.tolist(), strict=True):
            _, size, channel, sequence, log_ns, publish_ns = head
            if channel in channels:
                payload = content[start + MESSAGE_HEAD.itemsize : start + HEAD.size + size]
                writer.add_message(
                    channels[channel], sequence, log_ns % _U64, publish_ns % _U64, payload.data
                )
                count += 1
    for record in log.records(op.ATTACHMENT):
        writer.keep_attachment(encode_attachment(record.fields), record.fields)
    for record in log.records(op.METADATA):
        writer.about(record.fields["name"], record.fields["metadata"])
    writer.finish()
    return count


def _rewrite_other_log(log: Log, stream: BinaryIO) -> int:
    """Write one channel per topic; returns messages written."""
    profiles = {_PROFILES.get(topic.encoding, "") for topic in log.topics}
    writer = McapRecordWriter(stream, Contents(), crc=0)
    writer.begin(profiles.pop() if len(profiles) == 1 else "", LIBRARY)
    count = 0
    channels = {topic.id: keep_payloads(writer, topic) for topic in log.topics}
    for batch in log.batches():
        for log_ns, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
            writer.add_message(channels[batch.topic_id], 0, log_ns, log_ns, payload)
            count += 1
    writer.finish()
    return count
