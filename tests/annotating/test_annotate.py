import shutil

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from bodylog.annotating import annotate as module
from bodylog.errors import FormatError, InputError, LogError, UsageError
from bodylog.logs.formats import open_log
from bodylog.logs.mcap.prefix import reusable_prefix
from tests.annotating.annotated_logs import annotate_log, write_annotations
from tests.logs.written import (
    START,
    UNSUITED,
    amount,
    by_pybag,
    by_rosbags,
    foreign,
    outgoing,
    sought,
    source,
    streamed,
    without_times,
)

SAID = {"version": "1", "inputs": "{}"}


@pytest.fixture(scope="module")
def messages():
    return outgoing()


@pytest.fixture
def log(tmp_path):
    return source(tmp_path / "in.mcap")


def records(raw, at, end):
    """{opcode: position of its first record} from byte `at`."""
    found = {}
    while at < end:
        found.setdefault(raw[at], at)
        at += 9 + int.from_bytes(raw[at + 1 : at + 9], "little")
    return found


def data_section(path):
    """The bytes before DataEnd."""
    raw = path.read_bytes()
    return raw[: records(raw, 8, len(raw) - 8)[0x0F]]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_annotate_keeps_source_bytes_for_every_reader(tmp_path, seed, compression):
    from mcap.writer import CompressionType

    log, messages = source(tmp_path / "in.mcap", seed, compression=CompressionType[compression]), outgoing(seed)
    before, originals = data_section(log), streamed(log)
    annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    out = tmp_path / "out.mcap"
    assert out.read_bytes()[: len(before)] == before
    every = streamed(out)
    assert foreign(every) == originals and len(every) == len(originals) + amount(messages)
    assert sought(out) == every
    assert by_rosbags(out) == by_pybag(out) == sorted(without_times(every))


@pytest.mark.parametrize("how", UNSUITED)
def test_annotate_rewrites_logs_without_a_reusable_prefix(tmp_path, messages, how):
    log = source(tmp_path / "in.mcap", **UNSUITED[how])
    annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    every = streamed(tmp_path / "out.mcap")
    assert foreign(every) == streamed(log) and len(every) == 400 + amount(messages)
    assert sought(tmp_path / "out.mcap") == every
    assert by_rosbags(tmp_path / "out.mcap") == by_pybag(tmp_path / "out.mcap") == sorted(without_times(every))


@pytest.mark.parametrize("how", ["chunked", *UNSUITED])
def test_annotate_keeps_attachments_and_metadata(tmp_path, messages, how):
    log = source(tmp_path / "in.mcap", **UNSUITED.get(how, {}))
    annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        (attached,) = reader.iter_attachments()
        about = {m.name: m.metadata for m in reader.iter_metadata()}
        stats = reader.get_summary().statistics
    assert (attached.name, attached.data, attached.log_time) == ("calibration.yaml", b"focal: 600\n", START)
    assert about == {"operator": {"name": "somebody", "robot": "ur5"}, "bodylog": SAID}
    assert (stats.attachment_count, stats.metadata_count) == (1, 2)


def test_annotate_rewrites_a_truncated_log_up_to_the_damage(tmp_path, messages, log):
    whole = log.read_bytes()
    log.write_bytes(whole[: len(whole) // 2])
    findings = annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    every = streamed(tmp_path / "out.mcap")
    assert 100 < len(foreign(every)) < 400 and sought(tmp_path / "out.mcap") == every
    assert any(finding.severity == "lost" for finding in findings)


@pytest.mark.parametrize("crcs", [False, True])
@pytest.mark.parametrize("how", ["chunked", "unchunked"])
def test_annotate_is_deterministic_and_replaces_an_earlier_run(tmp_path, messages, crcs, how):
    log = source(tmp_path / "in.mcap", enable_data_crcs=crcs, **UNSUITED.get(how, {}))
    annotate_log(log, messages, SAID, tmp_path / "first.mcap")
    annotate_log(log, messages, SAID, tmp_path / "again.mcap")
    annotate_log(tmp_path / "first.mcap", outgoing(7), {"version": "other"}, tmp_path / "other.mcap")
    annotate_log(tmp_path / "other.mcap", messages, SAID, tmp_path / "back.mcap")
    first = (tmp_path / "first.mcap").read_bytes()
    assert first == (tmp_path / "again.mcap").read_bytes() == (tmp_path / "back.mcap").read_bytes()
    assert first != (tmp_path / "other.mcap").read_bytes()


def test_annotate_replaces_own_messages_between_others(tmp_path, messages, log):
    from mcap.writer import Writer

    annotate_log(log, messages, SAID, tmp_path / "first.mcap")
    with (tmp_path / "first.mcap").open("rb") as stream, (tmp_path / "mixed.mcap").open("wb") as out:
        writer = Writer(out, chunk_size=100_000)
        writer.start("ros2", "some merging tool")
        ids = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            if channel.id not in ids:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            times = {"log_time": message.log_time, "publish_time": message.publish_time, "sequence": message.sequence}
            writer.add_message(ids[channel.id], data=message.data, **times)
        writer.finish()
    annotate_log(tmp_path / "mixed.mcap", outgoing(7), SAID, tmp_path / "out.mcap")
    every = streamed(tmp_path / "out.mcap")
    assert foreign(every) == streamed(log) and len(every) == 400 + amount(outgoing(7))


def test_annotate_keeps_foreign_metadata_after_its_own(tmp_path, messages, log):
    with (tmp_path / "later.mcap").open("wb") as stream:
        kept = reusable_prefix(log)
        stream.write(log.read_bytes()[: kept.end])
        writer = module.McapRecordWriter(stream, kept.contents, kept.end)
        module.add_topics(writer, messages)
        writer.about("reviewed", {"by": "somebody"})
        writer.finish()
    annotate_log(tmp_path / "later.mcap", messages, SAID, tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as stream:
        assert {m.name for m in make_reader(stream).iter_metadata()} == {"operator", "reviewed", "bodylog"}


def test_annotate_continues_the_data_section_crc(tmp_path, messages):
    from mcap.stream_reader import StreamReader

    log = source(tmp_path / "in.mcap", enable_data_crcs=True)
    annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as stream:
        ends = [r for r in StreamReader(stream, validate_crcs=True).records if type(r).__name__ == "DataEnd"]
    assert ends[0].data_section_crc != 0


def test_annotate_keeps_only_requested_topics(tmp_path, messages, log):
    annotate_log(log, messages, SAID, tmp_path / "out.mcap", only=["/b"])
    kept = foreign(streamed(tmp_path / "out.mcap"))
    assert kept == [message for message in streamed(log) if message[0] == "/b"] and len(kept) == 200


def test_write_makes_a_log_of_only_our_messages(tmp_path, messages):
    write_annotations(messages, SAID, tmp_path / "out.mcap")
    every = streamed(tmp_path / "out.mcap")
    assert len(every) == amount(messages) and sought(tmp_path / "out.mcap") == every
    assert by_rosbags(tmp_path / "out.mcap") == by_pybag(tmp_path / "out.mcap") == sorted(without_times(every))


def test_annotate_output_is_decoded_by_pybag(tmp_path, messages):
    from pybag.mcap_reader import McapFileReader

    write_annotations(messages, SAID, tmp_path / "out.mcap")
    with McapFileReader.from_file(tmp_path / "out.mcap") as reader:
        assert sum(1 for topic in reader.get_topics() for _ in reader.messages(topic)) == amount(messages)


def test_annotate_refuses_the_input_as_output(tmp_path, messages, log):
    before = log.read_bytes()
    (tmp_path / "link.mcap").symlink_to(log)
    for out in (log, tmp_path / "link.mcap"):
        with pytest.raises(UsageError, match=r"is also an input .*choose another name"):
            annotate_log(log, messages, SAID, out)
    assert log.read_bytes() == before


def test_annotate_leaves_no_file_if_the_log_shrinks(tmp_path, messages, log, monkeypatch):
    base = reusable_prefix(log)
    monkeypatch.setattr(module, "reusable_prefix", lambda _: type(base)(base.end + 10**6, None, base.contents))
    with pytest.raises(LogError, match="was it still being recorded"):
        annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


def test_annotate_removes_a_file_that_fails_verification(tmp_path, messages, log, monkeypatch):
    monkeypatch.setattr(module.McapRecordWriter, "write", lambda *_: None)
    with pytest.raises(LogError, match=r"holds 400 messages where \d+ were written"):
        annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


LIES = {
    "statistics count other messages": (0x0B, 9 + 8 + 2 + 12 + 16 + 4 + 4 + 2 + 2, False),
    "has no message index": (0x08, 9 + 16, False),
    "chunk at byte .* has no message index": (0x08, 9 + 23, False),
    "list of message indexes is not": (0x08, 9 + 36 + 2, False),
    "lacks channel": (0x04, 9, False),
    "CRC fails": (0x03, 30, True),
}
"""Error text -> opcode of a summary record, the byte in it to change, whether the CRC stays."""


@pytest.mark.parametrize("reason", LIES)
def test_reusable_prefix_refuses_a_wrong_summary(tmp_path, messages, log, reason):
    opcode, byte, keeps_crc = LIES[reason]
    raw = bytearray(log.read_bytes())
    footer = len(raw) - 8 - 20
    summary = int.from_bytes(raw[footer : footer + 8], "little")
    raw[records(raw, summary, footer - 9)[opcode] + byte] ^= 0x40
    if not keeps_crc:
        raw[footer + 16 : footer + 20] = bytes(4)
    log.write_bytes(raw)
    with pytest.raises(FormatError, match=reason):
        reusable_prefix(log)
    annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    every = streamed(tmp_path / "out.mcap")
    assert len(foreign(every)) == 400 and sought(tmp_path / "out.mcap") == every


def test_annotate_of_the_arm_is_read_by_every_reader(tmp_path, arm, messages):
    log = shutil.copy(arm / "reach.mcap", tmp_path / "reach.mcap")
    annotate_log(log, messages, SAID, tmp_path / "out.mcap")
    every = streamed(tmp_path / "out.mcap")
    assert foreign(every) == streamed(log) and sought(tmp_path / "out.mcap") == every
    assert by_rosbags(tmp_path / "out.mcap") == by_pybag(tmp_path / "out.mcap") == sorted(without_times(every))


def test_annotate_reports_damaged_metadata(tmp_path, messages):
    log = source(tmp_path / "in.mcap", **UNSUITED["unchunked"])
    raw = bytearray(log.read_bytes())
    at = raw.index(b"\x08\0\0\0operator")
    raw[at + 3] = 0x7F
    log.write_bytes(raw)
    (finding,) = (f for f in annotate_log(log, messages, SAID, tmp_path / "out.mcap") if "left out" in f.text)
    assert finding.severity == "lost" and f"the record at byte {at - 9} is left out" in finding.text
    with (tmp_path / "out.mcap").open("rb") as stream:
        assert [m.name for m in make_reader(stream).iter_metadata()] == ["bodylog"]


@pytest.mark.soak
def test_annotate_accepts_every_recorded_log(tmp_path, arm, messages):
    suffixes = (".mcap", ".bag", ".db3", ".zst", ".active")
    logs = [path for path in arm.parent.rglob("*") if path.suffix in suffixes or (path / "metadata.yaml").exists()]
    written = 0
    for log in sorted(logs):
        try:
            with open_log(log) as opened:
                ours = {t.id for t in opened.topics if not t.name.startswith("/bodylog/")}
                count = sum(len(batch.log_ns) for batch in opened.batches(ours))
        except LogError:
            continue
        annotate_log(log, messages, SAID, tmp_path / "out.mcap")
        every = streamed(tmp_path / "out.mcap")
        assert len(every) == count + amount(messages), log
        assert sought(tmp_path / "out.mcap") == every, log
        written += 1
    assert written > 250


@pytest.mark.parametrize("seed", range(3))
def test_annotate_survives_damage_anywhere(tmp_path, seed):
    rng, messages = np.random.default_rng(seed), outgoing(seed, 20, 10)
    log, out = source(tmp_path / "in.mcap", count=60), tmp_path / "out.mcap"
    annotate_log(log, messages, SAID, tmp_path / "annotated.mcap")
    files = [log.read_bytes(), (tmp_path / "annotated.mcap").read_bytes()]
    kept = 0
    for number in range(40):
        raw = bytearray(files[number % 2])
        back = rng.integers(1, min(len(raw), 3000))
        raw[-back] ^= 1 << rng.integers(0, 8)
        log.write_bytes(raw[: len(raw) if rng.random() < 0.8 else rng.integers(1, len(raw))])
        try:
            annotate_log(log, messages, SAID, out)
        except InputError as problem:
            assert "\n" not in str(problem)
            continue
        with out.open("rb") as stream:
            assert make_reader(stream).get_summary().statistics.message_count >= amount(messages)
        kept += 1
    assert kept > 20


@pytest.mark.parametrize("text", [b"uint8 count\n", None])
def test_annotate_renames_conflicting_types(tmp_path, messages, text):
    kind, ours = "foxglove_msgs/msg/ImageAnnotations", next(o for o in messages if o.topic == "/bodylog/annotations")
    with (tmp_path / "in.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema(kind, "ros2msg", text or ours.definition)
        payload = b"\0\1\0\0\7" if text else bytes(ours.data[ours.offset[0] : ours.offset[0] + ours.length[0]])
        writer.add_message(writer.register_channel("/boxes", "cdr", schema), START, payload, START)
        writer.finish()
    findings = annotate_log(tmp_path / "in.mcap", messages, SAID, tmp_path / "out.mcap")
    assert len(by_rosbags(tmp_path / "out.mcap")) == 1 + amount(messages)
    with open_log(tmp_path / "out.mcap") as log:
        kinds = {topic.name: topic.type for topic in log.topics}
    if text:
        assert kinds["/bodylog/annotations"] == "bodylog_msgs/msg/ImageAnnotations"
        assert [f"/bodylog/annotations: the log has another {kind};" in f.text for f in findings] == [True]
    else:
        assert (kinds["/bodylog/annotations"], findings) == (kind, ())
