"""Rewrite the sound part of a log as a clean, indexed MCAP."""

from pathlib import Path
from typing import Any

from ...errors import LogError
from ...io.atomic_files import replace_atomically
from ...io.outputs import Output, guard_outputs
from ..formats import open_log, payload_views
from ..limits import LIMITS, Input
from ..mcap import opcodes as op
from ..mcap.chunks import MESSAGE_HEAD
from ..mcap.reader import McapLog
from ..mcap.records import HEAD, Record
from ..protocol import Log
from ..records import Finding, Topic

_U64 = 1 << 64
_PROFILES = {"cdr": "ros2", "ros1": "ros1"}


def rewrite_sound_messages(path: Path, out: Path, limits: Input = LIMITS) -> tuple[Finding, ...]:
    """Write the sound messages of `path` to the MCAP `out`
    and return what is wrong; LogError when none is sound.
    """
    guard_outputs([path], [Output(out, "--repair")])
    with open_log(path, limits=limits) as log, replace_atomically(out) as beside:
        written = (
            _rewrite_mcap(log, beside)
            if isinstance(log, McapLog)
            else _rewrite_other_log(log, beside)
        )
        if not written and any(finding.severity == "lost" for finding in log.findings):
            raise LogError(
                f"{path}: nothing in it can be saved; "
                f"{log.findings[-1].text.removeprefix(f'{path}: ')}"
            )
        _confirm_message_count(beside, written)
        return log.findings


def _open_mcap_writer(beside: Path, profile: str) -> Any:
    from mcap.writer import Writer

    writer = Writer(str(beside), enable_data_crcs=True)
    writer.start(profile=profile, library="bodylog")
    return writer


def _rewrite_mcap(log: McapLog, beside: Path) -> int:
    """Copy channels, sequence numbers, publish times,
    attachments and metadata unchanged; returns messages written.
    """
    header = next(log.records(op.HEADER), None)
    writer = _open_mcap_writer(beside, header.fields["profile"] if header else "")
    survey = log.survey
    count = 0
    schemas = {
        number: _register_schema(writer, record) for number, record in survey.schemas.items()
    }
    channels = {}
    for number, record in survey.channels.items():
        fields = record.fields
        schema = schemas.get(fields["schema_id"], 0)
        channels[number] = writer.register_channel(
            fields["topic"], fields["message_encoding"], schema, fields["metadata"]
        )
    for content, found in log.messages():
        for start, head in zip(found.starts.tolist(), found.heads.tolist(), strict=True):
            _, size, channel, sequence, log_ns, publish_ns = head
            if channel in channels:
                payload = content[start + MESSAGE_HEAD.itemsize : start + HEAD.size + size]
                writer.add_message(
                    channels[channel], log_ns % _U64, bytes(payload), publish_ns % _U64, sequence
                )
                count += 1
    for record in log.records(op.ATTACHMENT):
        fields = record.fields
        writer.add_attachment(
            fields["create_time"],
            fields["log_time"],
            fields["name"],
            fields["media_type"],
            bytes(fields["data"]),
        )
    for record in log.records(op.METADATA):
        writer.add_metadata(record.fields["name"], record.fields["metadata"])
    writer.finish()
    return count


def _register_schema(writer: Any, record: Record) -> int:
    fields = record.fields
    return int(writer.register_schema(fields["name"], fields["encoding"], fields["data"]))


def _rewrite_other_log(log: Log, beside: Path) -> int:
    """Write one channel per topic; returns messages written."""
    profiles = {_PROFILES.get(topic.encoding, "") for topic in log.topics}
    writer = _open_mcap_writer(beside, profiles.pop() if len(profiles) == 1 else "")
    count = 0
    channels = {topic.id: _register_topic_channel(writer, topic) for topic in log.topics}
    for batch in log.batches():
        for log_ns, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
            writer.add_message(channels[batch.topic_id], log_ns, bytes(payload), log_ns)
            count += 1
    writer.finish()
    return count


def _register_topic_channel(writer: Any, topic: Topic) -> int:
    ros1 = topic.encoding == "ros1"
    name = topic.type.replace("/msg/", "/") if ros1 else topic.type
    encoding = topic.definition_encoding or ("ros1msg" if ros1 else "ros2msg")
    schema = writer.register_schema(name, encoding, topic.definition)
    return int(writer.register_channel(topic.name, topic.encoding, schema, dict(topic.metadata)))


def _confirm_message_count(beside: Path, written: int) -> None:
    with open_log(beside, strict=True) as log:
        found = sum(len(batch.log_ns) for batch in log.batches())
    if found != written:
        raise LogError(
            f"{beside}: {written} messages were written, {found} can be read back; is the "
            "disk full?"
        )
