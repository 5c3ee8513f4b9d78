import io
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader

from bodylog.logs.mcap.encode import MessageTable, gather_pieces
from bodylog.logs.mcap.writer import CHUNK_BYTES, Contents, McapRecordWriter


def table(channels, rng, count, longest):
    length = rng.integers(0, longest, count)
    data = rng.integers(0, 256, int(length.sum()) + 7, dtype=np.uint8)
    log_ns = np.sort(rng.integers(0, 2**62, count))
    order = rng.permutation(count)
    offset = np.zeros(count, np.int64)
    offset[order] = np.cumsum(length[order]) - length[order] + 7
    channel = rng.choice(channels, count)
    return MessageTable(channel, np.arange(count), log_ns, log_ns + 3, (data,), offset, length)


def file_of(*tables, topics=3, **about):
    stream = io.BytesIO()
    writer = McapRecordWriter(stream, Contents(), crc=0)
    writer.begin("ros2", "test")
    for i in range(topics):
        writer.topic(f"/t{i}", "std_msgs/msg/Empty", "cdr", b"", "ros2msg", {"number": str(i)})
    for some in tables:
        writer.write(some)
    for name, pairs in about.items():
        writer.about(name, pairs)
    writer.finish()
    return stream.getvalue()


def expected(some):
    return [
        (f"/t{c - 1}", s, t, p, some.data[0][o : o + n].tobytes())
        for c, s, t, p, o, n in zip(
            some.channel, some.sequence, some.log_ns, some.publish_ns, some.offset, some.length, strict=True
        )
    ]


def rows(messages):
    return [(c.topic, m.sequence, m.log_time, m.publish_time, bytes(m.data)) for _, c, m in messages]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("count", "longest"), [(1, 1), (500, 40), (300, 20_000), (3, 3 * CHUNK_BYTES)])
def test_writer_output_is_read_by_stream_and_index(seed, count, longest):
    some = table([1, 2, 3], np.random.default_rng(seed), count, longest)
    written = file_of(some)
    by_index = make_reader(io.BytesIO(written), validate_crcs=True).iter_messages()
    assert rows(by_index) == expected(some)
    assert rows(NonSeekingReader(io.BytesIO(written), validate_crcs=True).iter_messages()) == expected(some)


def test_writer_summary_matches_the_content():
    rng = np.random.default_rng(0)
    parts = [table([1, 3], rng, 400, 9000), table([3], rng, 200, 10)]
    written = file_of(*parts, note={"b": "2", "a": "1"})
    summary = make_reader(io.BytesIO(written)).get_summary()
    stats = summary.statistics
    both = np.concatenate([p.channel for p in parts])
    assert stats.channel_message_counts == {1: (both == 1).sum(), 2: 0, 3: (both == 3).sum()}
    assert (stats.message_count, stats.channel_count, stats.schema_count) == (600, 3, 1)
    assert (stats.chunk_count, stats.metadata_count) == (len(summary.chunk_indexes), 1)
    times = np.concatenate([p.log_ns for p in parts])
    assert (stats.message_start_time, stats.message_end_time) == (times.min(), times.max())
    assert [m.metadata for m in make_reader(io.BytesIO(written)).iter_metadata()] == [{"a": "1", "b": "2"}]


def test_writer_chunks_are_about_a_mebibyte():
    written = file_of(table([1], np.random.default_rng(1), 4000, 4000))
    sizes = [c.uncompressed_size for c in make_reader(io.BytesIO(written)).get_summary().chunk_indexes]
    assert len(sizes) > 4 and max(sizes) < CHUNK_BYTES + 4100 and min(sizes[:-1]) > CHUNK_BYTES - 4100


def test_writer_stores_incompressible_data():
    rng = np.random.default_rng(2)
    noise, zeros = table([1], rng, 50, 5000), table([1], rng, 50, 5000)
    zeros = replace(zeros, data=(zeros.data[0] * 0,))
    chunks = make_reader(io.BytesIO(file_of(noise, zeros))).get_summary().chunk_indexes
    assert [c.compression for c in chunks] == ["", "zstd"]


def test_writer_crcs_are_right():
    written = file_of(table([1, 2], np.random.default_rng(3), 100, 100), note={})
    records = StreamReader(io.BytesIO(written), validate_crcs=True, emit_chunks=False).records
    assert sum(1 for _ in records) > 100


def test_writer_shares_schemas():
    contents = Contents(schemas={65535: b"\3" + bytes(10) + b"x"}, channels={1: b"", 65535: b""})
    writer = McapRecordWriter(io.BytesIO(), contents)
    numbers = [writer.topic(name, "a/msg/B", "cdr", b"int8 b", "ros2msg", {}) for name in "xyz"]
    assert numbers == [2, 3, 4] and set(contents.schemas) == {65535, 1}


def test_gather_keeps_the_requested_order():
    data = np.arange(20_000, dtype=np.uint8)
    offset, length = np.array([9, 0, 100, 3]), np.array([2, 3, 10_000, 0])
    packed, start = gather_pieces(data, offset, length)
    assert start.tolist() == [0, 2, 5, 10_005]
    assert packed.tobytes() == b"\x09\x0a\x00\x01\x02" + data[100:10_100].tobytes()
