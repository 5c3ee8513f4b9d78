"""Uncompressed chunks read together or one by one give the same messages and losses."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.mcap import reader

Read = tuple[dict[int, list[tuple[int, bytes]]], list[str]]


@pytest.fixture(autouse=True)
def small_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "_TOGETHER", 60_000)


def _write(path: Path, seed: int) -> bytearray:
    """Three topics in chunks of about 10 kB, a fourth that begins late."""
    rng = np.random.default_rng(seed)
    writer = Writer(str(path), chunk_size=10_000, compression=CompressionType.NONE)
    writer.start()
    schema = writer.register_schema("std_msgs/msg/UInt8", "ros2msg", b"uint8 x")
    channels = [writer.register_channel(f"/{name}", "cdr", schema) for name in "abc"]
    for time in range(600):
        if time == 400:
            channels.append(writer.register_channel("/late", "cdr", schema))
        payload = rng.integers(0, 256, rng.integers(0, 900), np.uint8).tobytes()
        writer.add_message(channels[rng.integers(len(channels))], time, payload, time)
    writer.finish()
    return bytearray(path.read_bytes())


def _read(path: Path) -> Read:
    """Log times and payloads by topic, and findings."""
    found: dict[int, list[tuple[int, bytes]]] = {}
    with open_log(path) as log:
        for batch in log.batches():
            of_topic = found.setdefault(batch.topic_id, [])
            of_topic += zip(batch.log_ns.tolist(), map(bytes, payload_views(batch)), strict=True)
        return found, [finding.text for finding in log.findings]


def _both(path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Read]:
    yield _read(path)
    with monkeypatch.context() as alone:
        alone.setattr(reader, "read_uncompressed_run", lambda *_: None)
        yield _read(path)


def test_together_reads_several_chunks(tmp_path: Path) -> None:
    _write(tmp_path / "a.mcap", 0)
    with reader.McapLog(tmp_path / "a.mcap") as log:
        counts = [len(some) for some in reader.group_uncompressed_chunks(log.survey.parts)]
        messages = [len(found.starts) for _, found in log.messages()]
    assert counts[0] == 1 and max(counts) >= 5 and sum(counts) == len(log.survey.parts)
    assert len(messages) == len(counts) and sum(messages) == 600


@pytest.mark.parametrize("seed", range(3))
def test_together_equals_single_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    _write(tmp_path / "a.mcap", seed)
    together, alone = _both(tmp_path / "a.mcap", monkeypatch)
    assert together == alone and sum(map(len, together[0].values())) == 600 and not together[1]


@pytest.mark.parametrize("summarised", [True, False])
@pytest.mark.parametrize("seed", range(12))
def test_together_equals_single_chunks_with_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, summarised: bool
) -> None:
    rng, path = np.random.default_rng(seed), tmp_path / "a.mcap"
    raw = _write(path, seed)
    for place in rng.integers(len(raw) // 10, int(0.8 * len(raw)), rng.integers(1, 5)):
        raw[place] ^= 1 << rng.integers(8)
    path.write_bytes(raw if summarised else raw[: int(0.9 * len(raw))])
    together, alone = _both(path, monkeypatch)
    assert together == alone
    assert together[1] and 0 < sum(map(len, together[0].values())) < 600


@pytest.mark.parametrize("change", ["one less", "twice the same", "before the chunk", "far behind"])
def test_together_detects_wrong_indexes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str) -> None:
    path = tmp_path / "a.mcap"
    raw = _write(path, 5)
    with reader.McapLog(path) as log:
        _, chunk = log.survey.parts[1:3]
        at = min(chunk.indexes.values())
    offset = at + 15 + 8
    lies = {
        "one less": (offset, (int.from_bytes(raw[offset + 16 : offset + 24], "little")).to_bytes(8, "little")),
        "twice the same": (offset + 16, bytes(raw[offset : offset + 8])),
        "before the chunk": (offset, (-200).to_bytes(8, "little", signed=True)),
        "far behind": (offset, (1 << 62).to_bytes(8, "little")),
    }
    where, what = lies[change]
    raw[where : where + len(what)] = what
    path.write_bytes(raw)
    together, alone = _both(path, monkeypatch)
    assert together == alone and sum(map(len, together[0].values())) == 600
    assert any("message indexes" in text for text in together[1])
