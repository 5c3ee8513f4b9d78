"""ROS 1 bags: everything written is read, in any order of fields, chunks and connections."""

import struct
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bodylog.logs.formats import open_log, payload_views
from fixtures import by_hand

from . import peers

FOLDER = Path(__file__).parents[2] / "fixtures" / "containers"
S = 10**9
times = st.integers(0, (1 << 32) * S - 1)
messages = st.lists(st.tuples(st.sampled_from(["/a", "/b", "/c"]), times, st.binary(max_size=80)), max_size=40)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(some=messages, compression=st.sampled_from(["none", "bz2", "lz4"]), indexed=st.booleans())
def test_open_reads_whatever_was_written(
    tmp_path: Path, some: list[by_hand.Message], compression: str, indexed: bool
) -> None:
    path = tmp_path / "x.bag"
    path.write_bytes(by_hand.bag(some, "pkg/Type", b"int32 x", compression, indexed))
    assert peers.ours(path) == Counter(some)
    with open_log(path) as log:
        assert {topic.name: topic.messages for topic in log.topics} == Counter(topic for topic, _, _ in some)
        written = [time for _, time, _ in some] or [0]
        assert (log.start_ns, log.end_ns) == (min(written), max(written))
        for topic in log.topics:
            assert (topic.type, topic.encoding, topic.definition_encoding) == ("pkg/msg/Type", "ros1", "ros1msg")
            found = [bytes(part) for batch in log.batches([topic.id]) for part in payload_views(batch)]
            assert found == [payload for name, _, payload in some if name == topic.name]
        assert [finding.severity for finding in log.findings] == ([] if indexed else ["warning"])


def _bag(records: list[bytes], index: list[bytes], chunks: int, connections: int) -> bytes:
    """A bag of one whole body; the header is padded as recorders do."""
    start = len(by_hand._MAGIC) + 8 + 4096
    body = b"".join(records)
    fields = {"op": b"\x03", "index_pos": struct.pack("<Q", start + len(body))}
    fields |= {"conn_count": struct.pack("<I", connections), "chunk_count": struct.pack("<I", chunks)}
    head = by_hand.record(b"", **fields)
    padding = start - len(by_hand._MAGIC) - len(head)
    return by_hand._MAGIC + by_hand.record(b" " * padding, **fields) + body + b"".join(index)


def _entry(time: int, offset: int) -> bytes:
    return struct.pack("<III", time // S, time % S, offset)


@pytest.mark.parametrize("swapped", [False, True])
def test_open_reads_headers_of_any_field_order(tmp_path: Path, swapped: bool) -> None:
    """Two messages with extra fields in another order than the usual recorder's."""
    connection = by_hand._connection(0, "/a", "pkg/Type", b"")
    plain = {"op": b"\x02", "conn": bytes(4), "time": struct.pack("<II", 1, 2)}
    other = {"time": struct.pack("<II", 3, 4), "note": b"x", "conn": bytes(4), "op": b"\x02"}
    kinds = (other, plain) if swapped else (plain, other)
    inside, offsets = connection, []
    for number in range(6):
        offsets.append(len(inside))
        inside += by_hand.record(bytes([number]), **kinds[number % 2])
    chunk = by_hand.record(inside, op=b"\x05", compression=b"none", size=struct.pack("<I", len(inside)))
    listed = b"".join(_entry(0, offset) for offset in offsets)
    index = by_hand.record(listed, op=b"\x04", ver=b"\x01\0\0\0", conn=bytes(4), count=struct.pack("<I", 6))
    info = by_hand._chunk_info([("/a", 1 * S + 2, b"")] * 6, {"/a": 0}, len(by_hand._MAGIC) + 8 + 4096)
    path = tmp_path / "x.bag"
    path.write_bytes(_bag([chunk, index], [connection, info], 1, 1))
    with open_log(path) as log:
        (batch,) = log.batches()
        assert [bytes(part) for part in payload_views(batch)] == [bytes([number]) for number in range(6)]
        expected = [1 * S + 2, 3 * S + 4] * 3
        assert batch.log_ns.tolist() == (expected[1:] + expected[:1] if swapped else expected)
        assert log.findings == ()


def test_open_ignores_an_incomplete_index(tmp_path: Path) -> None:
    whole = (FOLDER / "none.bag").read_bytes()
    at = whole.index(b"count=", whole.index(b"op=\x04")) + 6
    count = struct.unpack_from("<I", whole, at)[0]
    path = tmp_path / "x.bag"
    path.write_bytes(whole[:at] + struct.pack("<I", count - 1) + whole[at + 4 :])
    with open_log(path) as log:
        assert sum(len(batch.log_ns) for batch in log.batches()) == 60
        assert ["the index of the chunk" in finding.text for finding in log.findings] == [True]


def test_open_keeps_connection_metadata() -> None:
    with open_log(FOLDER / "none.bag") as log:
        assert all(topic.metadata == {"md5sum": "*"} for topic in log.topics)


def test_batches_open_only_the_topics_chunks(tmp_path: Path) -> None:
    some = [("/a", number * S, b"x" * 50) for number in range(40)]
    some[25] = ("/b", 25 * S, b"here")
    whole = by_hand.bag(some, "pkg/Type", b"", "lz4")
    data, at, seen = bytearray(whole), 0, 0
    while (at := whole.find(b"\x04\x22\x4d\x18", at + 1)) > 0:
        if seen != 2:
            data[at : at + 8] = bytes(8)
        seen += 1
    path = tmp_path / "x.bag"
    path.write_bytes(data)
    with open_log(path) as log:
        (wanted,) = [topic.id for topic in log.topics if topic.name == "/b"]
        (batch,) = log.batches([wanted])
        assert [bytes(part) for part in payload_views(batch)] == [b"here"]
        assert log.findings == ()
        assert sum(len(batch.log_ns) for batch in log.batches()) == 10
        assert [finding.severity for finding in log.findings] == ["lost"] * 3
