"""The examination names what is wrong with each broken log; repairs hold exactly what is sound."""

import json
import struct
import zlib
from collections import Counter
from pathlib import Path

import pytest

from bodylog.errors import LogError, UsageError
from bodylog.logs.conversion.examination import examine_log_file, rewrite_sound_messages
from bodylog.logs.formats import open_log

from . import peers

FOLDER = Path(__file__).parents[2] / "fixtures" / "containers"
LOGS = Path(__file__).parents[2].parent / "shared" / "logs"
EXPECTED = json.loads((FOLDER / "expected.json").read_text())
READ = [name for name, content in EXPECTED.items() if "messages" in content]
SOUND = [name for name in READ if EXPECTED[name]["worst"] is None and name != "empty_definition.bag"]


def texts(path: Path) -> str:
    return "\n".join(finding.text for finding in examine_log_file(path))


@pytest.mark.parametrize("name", SOUND)
def test_examine_finds_nothing_in_a_sound_log(name: str) -> None:
    assert examine_log_file(FOLDER / name) == ()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("flipped_bit.mcap", "the chunk's CRC is"),
        ("wrong_index.mcap", "gives offsets or log times that are not those of the messages"),
        ("wrong_statistics.mcap", "the statistics say message_count 99, the file holds 60"),
        ("wrong_summary_crc.mcap", "the summary is not used: its CRC is"),
        ("chunk_claims_1_TB.mcap", "declare 1099511627776 bytes"),
        ("cut_after_chunk.mcap", "the file ends without its footer"),
        ("wrong_index.bag", "the index of the chunk at byte 4117 is wrong"),
        ("killed.bag.active", "the bag was never closed"),
        ("empty_definition.bag", "std_msgs/msg/Float64 has no definition"),
        ("renamed", "metadata.yaml is not readable"),
    ],
)
def test_examine_names_each_fault(name: str, text: str) -> None:
    assert text in texts(FOLDER / name)


def _patched(tmp_path: Path, opcode: int, offset: int, new: bytes, sealed: bool = True) -> Path:
    """none.mcap with changed bytes in the first record of that opcode, and a valid summary CRC."""
    data, at = bytearray((FOLDER / "none.mcap").read_bytes()), 8
    while data[at] != opcode:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    data[at + offset : at + offset + len(new)] = new
    footer = len(data) - 37
    start = struct.unpack_from("<Q", data, footer + 9)[0]
    if sealed:
        struct.pack_into("<I", data, footer + 25, zlib.crc32(data[start : footer + 25]))
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("opcode", "offset", "new", "text"),
    [
        (11, 9 + 8, b"\x09", "the statistics say schema_count 9, the file holds 1"),
        (11, 9 + 10, b"\x09", "the statistics say channel_count 9, the file holds 2"),
        (11, 9 + 22, b"\x09", "the statistics say chunk_count 9, the file holds 6"),
        (11, 9 + 26, bytes(8), "the statistics say message_start_time 0, the file holds 1700000000000000000"),
        (8, 9, bytes(8), "the chunk index says message_start_time 0 of the chunk at byte"),
        (14, 9, b"\x04", "the summary offset of opcode 4 points to others"),
        (15, 9, b"\x01\x02\x03\x04", "the data section has CRC"),
        (6, 9, bytes(8), "declares log times 0 to 17"),
    ],
)
def test_examine_checks_what_readers_do_not(tmp_path: Path, opcode: int, offset: int, new: bytes, text: str) -> None:
    assert text in texts(_patched(tmp_path, opcode, offset, new))


def test_examine_counts_messages_out_of_order(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "x.mcap"
    writer = Writer(str(path))
    writer.start()
    channel = writer.register_channel("/late", "json", writer.register_schema("T", "jsonschema", b"{}"))
    for log_time in (5, 3, 4, 2_000_000_000, 1):
        writer.add_message(channel, log_time, b"{}", log_time)
    writer.finish()
    assert "/late: 2 messages have a log time before their predecessor's, by up to 2.000000 s" in texts(path)


def test_examine_compares_metadata_yaml_with_the_files(tmp_path: Path) -> None:
    text = (FOLDER / "split.bag" / "metadata.yaml").read_text()
    for file in (FOLDER / "split.bag").glob("*.db3"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "metadata.yaml").write_text(text.replace("message_count: 60", "message_count: 61").replace("/b", "/c"))
    found = texts(tmp_path)
    assert "metadata.yaml says message_count 61, the files hold 60" in found
    assert "metadata.yaml does not name topic /b" in found
    assert "(and 1 more like it)" in found


@pytest.mark.parametrize("name", READ)
def test_repair_keeps_what_is_sound(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    findings = rewrite_sound_messages(FOLDER / name, out)
    assert findings == open_and_read(FOLDER / name)
    assert peers.ours(out) == peers.ours(FOLDER / name)
    assert peers.mcap_seeking(out) == peers.ours(out)
    if name != "empty_definition.bag":
        assert examine_log_file(out) == ()
    again = tmp_path / "again.mcap"
    rewrite_sound_messages(FOLDER / name, again)
    assert again.read_bytes() == out.read_bytes()


def open_and_read(path: Path) -> tuple[object, ...]:
    with open_log(path) as log:
        for _ in log.batches():
            pass
        return log.findings


def test_repair_keeps_sequence_times_channels_and_extras(tmp_path: Path) -> None:
    from mcap.reader import make_reader
    from mcap.writer import Writer

    path, out = tmp_path / "x.mcap", tmp_path / "out.mcap"
    writer = Writer(str(path))
    writer.start(profile="mine")
    schema = writer.register_schema("T", "jsonschema", b"{}")
    channels = [writer.register_channel("/a", "json", schema, {"from": name}) for name in ("one", "two")]
    for number in range(20):
        writer.add_message(channels[number % 2], 100 + number, b"{}", 50 + number, 1000 + number)
    writer.add_attachment(1, 2, "notes.txt", "text/plain", b"hello")
    writer.add_metadata("about", {"robot": "ur5"})
    writer.finish()
    assert rewrite_sound_messages(path, out) == ()

    def content(file: Path) -> list[object]:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            messages = [
                (channel.topic, channel.metadata, m.sequence, m.log_time, m.publish_time, m.data)
                for _, channel, m in reader.iter_messages()
            ]
            assert reader.get_header().profile == "mine"
            return [messages, list(reader.iter_attachments()), list(reader.iter_metadata())]

    assert content(out) == content(path)


def test_repair_refuses_the_input_as_output(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes((FOLDER / "none.mcap").read_bytes())
    with pytest.raises(UsageError, match="choose another name"):
        rewrite_sound_messages(path, path)


def test_repair_writes_nothing_when_nothing_is_sound(tmp_path: Path) -> None:
    path, out = tmp_path / "x.mcap", tmp_path / "out.mcap"
    path.write_bytes((FOLDER / "none.mcap").read_bytes()[:60])
    with pytest.raises(LogError, match="nothing in it can be saved"):
        rewrite_sound_messages(path, out)
    assert not out.exists()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(not LOGS.is_dir(), reason=f"the recorded logs are not at {LOGS}")
@pytest.mark.parametrize("name", ["test_sample_truncated.mcap", "test_truncated.bag", "gps.bag.active", "reach.bag"])
def test_repair_output_is_read_by_every_reader(name: str, tmp_path: Path) -> None:
    path, out = next(LOGS.rglob(name)), tmp_path / "out.mcap"
    rewrite_sound_messages(path, out)
    wanted = peers.ours(path)
    assert peers.mcap_seeking(out) == peers.mcap_streaming(out) == wanted
    assert Counter(topic for topic, _, _ in wanted.elements()).total() > 0
