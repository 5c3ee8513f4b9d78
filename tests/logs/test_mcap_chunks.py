"""Messages outside chunks, found in bulk: the same as one by one, for all lengths and damage."""

import random
from pathlib import Path

import pytest
from mcap.writer import Writer

from bodylog.errors import BodylogError
from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.mcap import opcodes as op
from bodylog.logs.mcap import resync
from bodylog.logs.mcap.chunks import LooseRecords, follow_messages, loose_messages
from bodylog.logs.mcap.records import HEAD, MAGIC, iter_records

SEEDS = range(12)


def unchunked(path: Path, seed: int, finish: bool = True) -> bytes:
    """Write runs of equal and unequal messages on topics that begin at any time; returns the file's bytes."""
    draw = random.Random(seed)
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema("std_msgs/msg/UInt8", "ros2msg", b"uint8 data")
        channels = [writer.register_channel("/0", "cdr", schema)]
        for number in range(draw.choice((3, 60, 600))):
            if draw.random() < 0.02:
                channels.append(writer.register_channel(f"/{len(channels)}", "cdr", schema))
            size = 24 if number % 200 < 100 else draw.randrange(0, 90)
            writer.add_message(draw.choice(channels), number * 1_000_000, bytes(size), number)
        if finish:
            writer.finish()
        else:
            stream.flush()
    return path.read_bytes()


def damaged(content: bytes, seed: int) -> bytes:
    draw, out = random.Random(seed), bytearray(content)
    for _ in range(draw.randrange(4)):
        out[draw.randrange(len(MAGIC), len(out))] ^= 1 << draw.randrange(8)
    return bytes(out[: draw.choice((len(out), len(out), draw.randrange(len(MAGIC), len(out))))])


def everything(path: Path) -> object:
    try:
        with open_log(path) as log:
            found = [
                (batch.topic_id, log_ns, bytes(payload))
                for batch in log.batches()
                for log_ns, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True)
            ]
            return sorted(found), repr(log.topics), log.start_ns, log.end_ns, repr(log.findings)
    except BodylogError as problem:
        return str(problem)


@pytest.mark.parametrize("finish", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_following_equals_single_records(tmp_path, monkeypatch, seed, finish):
    path = tmp_path / "x.mcap"
    content = unchunked(path, seed, finish)
    for spoilt in (content, *(damaged(content, 100 * seed + k) for k in range(8))):
        path.write_bytes(spoilt)
        many = everything(path)
        with monkeypatch.context() as slowly:
            slowly.setattr(resync, "_FEW", 1 << 60)
            assert everything(path) == many


@pytest.mark.parametrize("seed", SEEDS)
def test_following_finds_the_messages_of_iter_records(tmp_path, seed):
    data = memoryview(unchunked(tmp_path / "x.mcap", seed))
    end = len(data) - len(MAGIC)
    expected = [at - HEAD.size for opcode, at, _ in iter_records(data, len(MAGIC), end) if opcode == op.MESSAGE]
    found = [int(at) for some in loose_messages(data, LooseRecords(len(MAGIC), end)) for at in some.starts]
    assert found == expected


def test_following_ends_before_a_truncated_message():
    whole = HEAD.pack(op.MESSAGE, 30) + bytes(30)
    for count in (3, 40):
        for tail in (whole[:-1], HEAD.pack(op.MESSAGE, 21) + bytes(21), HEAD.pack(op.MESSAGE, 1 << 63), b"\x05"):
            data = memoryview(whole * count + tail)
            starts, after = follow_messages(data, 0, len(data))
            assert (starts.tolist(), after) == ([39 * k for k in range(count)], 39 * count)
