"""MCAP: every written message is read; only requested chunks are opened; wrong declarations are refused."""

import re
import struct
import tracemalloc
from collections import Counter, deque
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from bodylog.errors import FormatError
from bodylog.logs.decode.ros1_to_cdr import known_definition
from bodylog.logs.encode.cdr import CdrField, serialise_messages
from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.mcap import opcodes as op
from bodylog.logs.mcap.records import parse_record
from bodylog.logs.storage.compression import Buffer
from bodylog.recording.recording import read_recording
from bodylog.settings import Settings
from bodylog.types import LazyImage

from . import peers

FOLDER = Path(__file__).parents[2] / "fixtures" / "containers"
options = st.fixed_dictionaries(
    {
        "chunk_size": st.sampled_from([1, 300, 5000]),
        "compression": st.sampled_from(list(CompressionType)),
        "index_types": st.sampled_from([IndexType.ALL, IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE]),
        "repeat_channels": st.booleans(),
        "repeat_schemas": st.booleans(),
        "use_chunking": st.booleans(),
        "use_statistics": st.booleans(),
        "use_summary_offsets": st.booleans(),
        "enable_crcs": st.booleans(),
        "enable_data_crcs": st.booleans(),
    }
)
messages = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 1 << 62), st.binary(max_size=200).filter(lambda raw: raw[:1] != b"(")),
    max_size=40,
)
"""No payload begins as zstd does: CDR never begins so, and is taken to be packed when it does."""
SCHEMAS = ("", "pkg/msg/One", "pkg/msg/Two")
TOPICS = [("/a", 1, "cdr"), ("/a", 2, "cdr"), ("/b", 1, "ros1"), ("/c", 0, "json")]
"""Topic, schema, encoding of each channel: one name with two schemas, one channel without a schema."""


def write(path: Path, some: list[tuple[int, int, bytes]], **options: Any) -> Writer:
    writer = Writer(str(path), **options)
    writer.start(profile="anything")
    for name in ("pkg/One", "pkg/msg/Two"):
        writer.register_schema(name, "ros2msg", name.encode())
    channels = [writer.register_channel(topic, encoding, schema) for topic, schema, encoding in TOPICS]
    for number, (channel, time, payload) in enumerate(some):
        writer.add_message(channels[channel], time, payload, number, number)
    return writer


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(some=messages, options=options)
def test_open_reads_whatever_a_writer_does(
    tmp_path: Path, some: list[tuple[int, int, bytes]], options: dict[str, Any]
) -> None:
    path = tmp_path / "x.mcap"
    write(path, some, **options).finish()
    assert peers.ours(path) == Counter((TOPICS[channel][0], time, payload) for channel, time, payload in some)
    with open_log(path, strict=True) as log:
        assert sum(topic.messages for topic in log.topics) == len(some)
        for topic in [topic for topic in log.topics if topic.messages]:
            found = [bytes(part) for batch in log.batches([topic.id]) for part in payload_views(batch)]
            mine = TOPICS.index((topic.name, SCHEMAS.index(topic.type), topic.encoding))
            assert found == [payload for channel, _, payload in some if channel == mine]
            assert topic.messages == len(found)
        assert log.findings == ()


def test_open_finds_a_schema_in_another_chunk(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    options = {"chunk_size": 1, "repeat_schemas": False, "use_statistics": False}
    write(path, [(3, 0, b"{}"), (0, 0, b"x")], **options).finish()
    with open_log(path, strict=True) as log:
        assert {topic.type for topic in log.topics if topic.messages} == {"", "pkg/msg/One"}
        assert log.findings == ()


def test_open_separates_schemas_of_one_name(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    write(path, [(channel, 1, b"x") for channel in range(4)]).finish()
    with open_log(path) as log:
        found = [(topic.name, topic.type, topic.encoding, topic.definition) for topic in log.topics]
        assert found == [
            ("/a", "pkg/msg/One", "cdr", b"pkg/One"),
            ("/a", "pkg/msg/Two", "cdr", b"pkg/msg/Two"),
            ("/b", "pkg/msg/One", "ros1", b"pkg/One"),
            ("/c", "", "json", b""),
        ]
        assert [topic.id for topic in log.topics] == [0, 1, 2, 3]


def test_open_merges_publishers_in_file_order(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    writer = Writer(str(path))
    writer.start()
    schema = writer.register_schema("pkg/msg/One", "ros2msg", b"")
    channels = [writer.register_channel("/tf", "cdr", schema, {"callerid": name}) for name in ("a", "b")]
    for number in range(10):
        writer.add_message(channels[number % 2], number, bytes([number]), number)
    writer.finish()
    with open_log(path) as log:
        assert [(topic.name, topic.messages) for topic in log.topics] == [("/tf", 10)]
        (batch,) = log.batches()
        assert [bytes(payload) for payload in payload_views(batch)] == [bytes([number]) for number in range(10)]


def test_batches_open_only_the_topics_chunks(tmp_path: Path) -> None:
    """All chunks except that of /b are damaged: reading /b neither meets nor reports it."""
    path, some = tmp_path / "x.mcap", [(0, time, bytes(500)) for time in range(50)]
    some[25] = (2, 25, b"here")
    write(path, some, chunk_size=600, compression=CompressionType.NONE).finish()
    data, at = bytearray(path.read_bytes()), 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 6 and b"here" not in data[at : at + length]:
            data[at + 300] ^= 1
        at += 9 + length
    path.write_bytes(data)
    with open_log(path) as log:
        (wanted,) = [topic.id for topic in log.topics if topic.name == "/b"]
        (batch,) = log.batches([wanted])
        assert [bytes(payload) for payload in payload_views(batch)] == [b"here"]
        assert log.findings == ()
        assert sum(len(batch.log_ns) for batch in log.batches()) < 10
        assert {finding.severity for finding in log.findings} == {"lost"}


def test_open_reads_messages_outside_chunks(tmp_path: Path) -> None:
    """Chunks were appended to a log without: seeking readers give only the appended messages."""
    loose, chunked = tmp_path / "loose.mcap", tmp_path / "chunked.mcap"
    write(loose, [(0, 1, b"first"), (0, 2, b"second")], use_chunking=False).finish()
    write(chunked, [(0, 3, b"third")], compression=CompressionType.NONE).finish()
    head = loose.read_bytes()
    end = _first(head, 15)
    tail = bytearray(chunked.read_bytes()[_first(chunked.read_bytes(), 6) :])
    shift = end - _first(chunked.read_bytes(), 6)
    footer = len(tail) - 37
    _move(tail, footer + 9, shift)
    for at in _all(tail, 8):
        _move(tail, at + 25, shift)
        entries = struct.unpack_from("<I", tail, at + 41)[0] // 10
        for entry in range(entries):
            _move(tail, at + 45 + 10 * entry + 2, shift)
    struct.pack_into("<I", tail, footer + 25, 0)
    path = tmp_path / "x.mcap"
    path.write_bytes(head[:end] + tail)
    assert set(peers.ours(path)) == {("/a", 1, b"first"), ("/a", 2, b"second"), ("/a", 3, b"third")}
    assert len(peers.mcap_seeking(path)) == 1


def _all(data: bytes | bytearray, opcode: int, at: int = 0) -> list[int]:
    found = []
    while at < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, at)
        found += [at] * (kind == opcode)
        at += 9 + length
    return found


def _first(data: bytes, opcode: int) -> int:
    return _all(data, opcode, 8)[0]


def _move(data: bytearray, at: int, shift: int) -> None:
    struct.pack_into("<Q", data, at, struct.unpack_from("<Q", data, at)[0] + shift)


def test_batches_decompress_single_payloads(tmp_path: Path) -> None:
    import zstandard

    packed = [zstandard.ZstdCompressor().compress(b"\x00\x01\x00\x00" + bytes([number]) * 50) for number in range(4)]
    packed[2] = packed[2][:-4]
    path = tmp_path / "x.mcap"
    write(path, [(0, number, payload) for number, payload in enumerate(packed)]).finish()
    with open_log(path) as log:
        (batch,) = log.batches()
        assert batch.log_ns.tolist() == [0, 1, 3]
        assert [bytes(payload)[-1] for payload in payload_views(batch)] == [0, 1, 3]
        assert [finding.severity for finding in log.findings] == ["lost"]


@pytest.mark.parametrize(
    ("opcode", "body"),
    [
        (op.SCHEMA, struct.pack("<HI", 1, 1 << 31) + b"x"),
        (op.CHANNEL, struct.pack("<HHI", 1, 1, 5) + b"topic" + struct.pack("<I", 3) + b"cd"),
        (op.CHANNEL, struct.pack("<HHIII", 1, 1, 0, 0, 7) + b"\x01\x00\x00\x00a\xff\xff"),
        (8, struct.pack("<QQQQI", 0, 0, 0, 0, 11) + bytes(11)),
    ],
)
def test_parse_refuses_fields_past_the_end(opcode: int, body: bytes) -> None:
    with pytest.raises(FormatError):
        parse_record(opcode, memoryview(body))


@pytest.mark.parametrize("compression", ["lz4", "zstd", "bz2"])
def test_load_allocates_nothing_for_a_false_size(compression: str) -> None:
    tracemalloc.start()
    with pytest.raises(FormatError, match="packed bytes declare"):
        Buffer().load(compression, memoryview(bytes(100)), 1 << 40)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


def test_load_stops_at_the_declared_size() -> None:
    import zstandard

    bomb = zstandard.ZstdCompressor().compress(bytes(50 << 20))
    tracemalloc.start()
    with pytest.raises(FormatError):
        Buffer().load("zstd", memoryview(bomb), 1000)
    assert tracemalloc.get_traced_memory()[1] < 4 << 20
    tracemalloc.stop()


def _peak(path: Path) -> int:
    tracemalloc.start()
    with open_log(path) as log:
        count = sum(len(batch.log_ns) for batch in log.batches())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count
    return peak


@pytest.mark.parametrize("chunked", [True, False])
def test_batches_use_constant_memory(tmp_path: Path, chunked: bool) -> None:
    noise = np.random.default_rng(0).integers(0, 256, 1 << 20, np.uint8).tobytes()
    some = [(0, time, noise[time % 1000 : time % 1000 + 2000]) for time in range(60_000)]
    paths = [tmp_path / "short.mcap", tmp_path / "long.mcap"]
    for path, count in zip(paths, (6_000, 60_000), strict=True):
        write(path, some[:count], compression=CompressionType.LZ4, use_chunking=chunked).finish()
    _peak(paths[0])  # exclude one-time imports
    assert _peak(paths[1]) < 1.1 * _peak(paths[0]) + (1 << 18)


def test_batch_is_valid_until_the_next(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    some = [(0, time, bytes([time]) * 300) for time in range(30)]
    write(path, some, chunk_size=1000).finish()
    with open_log(path) as log:
        found = []
        for batch in log.batches():
            found += [(time, bytes(part)) for time, part in zip(batch.log_ns.tolist(), payload_views(batch), strict=True)]
    assert found == [(time, payload) for _, time, payload in some]


def test_every_record_equals_the_streaming_reader(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.finish()
    path = tmp_path / "empty.mcap"
    path.write_bytes(stream.getvalue())
    with open_log(path, strict=True) as log:
        assert (log.topics, log.start_ns, log.end_ns, list(log.batches()), log.findings) == ((), 0, 0, [], ())


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the kernel does not say what is resident")
def test_batches_drop_pages(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    payload = np.random.default_rng(0).integers(0, 256, 100_000, np.uint8).tobytes()
    writer = Writer(str(path), compression=CompressionType.NONE, chunk_size=90_000)
    writer.start()
    channel = writer.register_channel("/a", "cdr", writer.register_schema("std_msgs/msg/UInt8", "ros2msg", b"uint8 x"))
    for time in range(2000):
        writer.add_message(channel, time, payload, time)
    writer.finish()
    resident = []
    with open_log(path) as log:
        for batch in log.batches():
            for one in payload_views(batch):
                assert bytes(one) == payload
                resident.append(_resident_file())
    assert len(resident) == 2000
    assert max(resident) - resident[0] < 40 << 20


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the kernel does not say what is resident")
def test_frames_are_not_copied_and_drop_pages(tmp_path: Path) -> None:
    path, size = tmp_path / "long.mcap", 1 << 20
    noise = np.random.default_rng(0).integers(0, 256, (1, size), np.uint8)
    fields: list[CdrField] = [("uint32", 1), ("uint32", 0), ("string", ""), ("uint32", 512), ("uint32", 2048)]
    fields += [("string", "mono8"), ("uint8", 0), ("uint32", 2048), ("uint8[]", noise)]
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2")
        kind = "sensor_msgs/msg/Image"
        channel = writer.register_channel("/a", "cdr", writer.register_schema(kind, "ros2msg", known_definition(kind)))
        for time in range(0, 200_000_000_000, 1_000_000_000):
            writer.add_message(channel, time, serialise_messages(1, fields).data.tobytes(), time)
        writer.finish()
    recording = read_recording(path, Settings())
    assert recording.cameras.frames is not None
    tracemalloc.start()
    behind: deque[LazyImage] = deque()
    resident = []
    for frame in recording.cameras.frames():
        behind.append(frame)
        if len(behind) > 20:
            assert behind.popleft().decode(1)[511, 2047].tolist() == [noise[0, -1]] * 3
            resident.append(_resident_file())
    assert tracemalloc.get_traced_memory()[1] < 4 * size
    tracemalloc.stop()
    assert len(resident) == 180 and max(resident) - resident[0] < 48 << 20


def _resident_file() -> int:
    """Bytes of mapped files in memory."""
    found = re.search(r"RssFile:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return 1024 * int(found[1])
