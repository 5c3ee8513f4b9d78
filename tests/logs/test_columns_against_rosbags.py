"""Columns against rosbags' single messages: random definitions, in every container, compression and profile."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2

import bodylog.logs as logs

from .random_messages import Messages, assert_row, values

START = 1_700_000_000_000_000_000
COUNT = 30


@dataclass(frozen=True)
class Sent:
    """One topic: its messages' definition, and (log time ns, payload) in the order written."""

    topic: str
    of: Messages
    messages: Sequence[tuple[int, bytes]]


def sent(seed: int, dialect: str, in_order: bool = True) -> list[Sent]:
    found = []
    for number in range(2):
        of = Messages(10 * seed + number, dialect, f"test{number}_msgs")
        times = np.random.default_rng(seed).permutation(COUNT) if not in_order else range(COUNT)
        found.append(Sent(f"/t{number}", of, [(START + int(k) * 10_000_000, of.payload()) for k in times]))
    return found


def interleaved(topics: Sequence[Sent]):
    for k in range(COUNT):
        for number, one in enumerate(topics):
            yield number, *one.messages[k]


Write = Callable[[Path, Sequence[Sent]], Path]


def mcap(profile: str = "ros2", **options) -> Write:
    def write(folder: Path, topics: Sequence[Sent]) -> Path:
        path = folder / "x.mcap"
        with path.open("wb") as stream:
            writer = McapWriter(stream, chunk_size=2048, **options)
            writer.start(profile=profile, library="test")
            dialect = topics[0].of.dialect
            encoding = {"ros1": "ros1", "ros2": "cdr"}[dialect]
            names = [one.of.root.replace("/msg/", "/msg/" if dialect == "ros2" else "/") for one in topics]
            texts = [one.of.text.encode() for one in topics]
            schemas = [writer.register_schema(n, f"{dialect}msg", text) for n, text in zip(names, texts, strict=True)]
            channels = [writer.register_channel(one.topic, encoding, s) for one, s in zip(topics, schemas, strict=True)]
            for number, t, payload in interleaved(topics):
                writer.add_message(channels[number], t, payload, t)
            writer.finish()
        return path

    return write


def bag(compression=None) -> Write:
    def write(folder: Path, topics: Sequence[Sent]) -> Path:
        out = Bag1(folder / "x.bag")
        if compression is not None:
            out.set_compression(compression)
        with out as writer:
            found = [writer.add_connection(one.topic, one.of.root, typestore=one.of.store) for one in topics]
            for number, t, payload in interleaved(topics):
                writer.write(found[number], t, payload)
        return folder / "x.bag"

    return write


def rosbag2(version: int, storage: StoragePlugin, mode: CompressionMode = CompressionMode.NONE) -> Write:
    def write(folder: Path, topics: Sequence[Sent]) -> Path:
        out = Bag2(folder / "x", version=version, storage_plugin=storage)
        if mode is not CompressionMode.NONE:
            out.set_compression(mode, CompressionFormat.ZSTD)
        with out as writer:
            found = [writer.add_connection(one.topic, one.of.root, typestore=one.of.store) for one in topics]
            for number, t, payload in interleaved(topics):
                writer.write(found[number], t, payload)
        return folder / "x"

    return write


NOTHING_REPEATED = {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False,
                    "use_summary_offsets": False}  # fmt: skip
SITUATIONS: dict[str, tuple[str, Write]] = {
    **{f"mcap {kind.name.lower()}": ("ros2", mcap(compression=kind)) for kind in CompressionType},
    **{f"mcap of ros1 {kind.name.lower()}": ("ros1", mcap("ros1", compression=kind)) for kind in CompressionType},
    "mcap without chunks": ("ros2", mcap(use_chunking=False)),
    "mcap of ros1 without chunks": ("ros1", mcap("ros1", use_chunking=False)),
    "mcap without a profile": ("ros2", mcap("")),
    "mcap with nothing repeated": ("ros2", mcap(**NOTHING_REPEATED)),
    "mcap without chunks, nothing repeated": ("ros2", mcap(use_chunking=False, **NOTHING_REPEATED)),
    "mcap without indexes": ("ros2", mcap(index_types=IndexType.NONE)),
    "mcap with chunk indexes alone": ("ros2", mcap(index_types=IndexType.CHUNK)),
    "mcap with message indexes alone": ("ros2", mcap(index_types=IndexType.MESSAGE)),
    "mcap without crcs": ("ros2", mcap(enable_crcs=False)),
    "mcap with a crc of its data": ("ros2", mcap(enable_data_crcs=True)),
    "bag": ("ros1", bag()),
    "bag bz2": ("ros1", bag(Bag1.CompressionFormat.BZ2)),
    "bag lz4": ("ros1", bag(Bag1.CompressionFormat.LZ4)),
    **{f"db3 version {version}, {mode.name.lower()}": ("ros2", rosbag2(version, StoragePlugin.SQLITE3, mode))
       for version in (8, 9) for mode in (CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE)},
    **{f"rosbag2 mcap version {version}, {mode.name.lower()}": ("ros2", rosbag2(version, StoragePlugin.MCAP, mode))
       for version in (8, 9) for mode in (CompressionMode.NONE, CompressionMode.STORAGE)},
}  # fmt: skip


def assert_the_same(path: Path, topics: Sequence[Sent]) -> None:
    """Assert that every field of every topic equals what rosbags decodes, message by message."""
    with logs.open(path, strict=True) as log:
        assert [topic.name for topic in log.topics] == [one.topic for one in topics]
        for one in topics:
            table, store = log[one.topic], one.of.store
            decode = store.deserialize_ros1 if one.of.dialect == "ros1" else store.deserialize_cdr
            rows = sorted(one.messages, key=lambda message: message[0])
            messages = [decode(payload, one.of.root) for _, payload in rows]
            assert table.log_ns.tolist() == [t for t, _ in rows] and not table.rejected
            for field in table.fields:
                column = table[field]
                assert len(column) == COUNT
                for row, message in zip(column, messages, strict=True):
                    assert_row(row, values(message, field), field)


@pytest.mark.parametrize("name", SITUATIONS)
def test_columns_equal_rosbags_in_every_container(tmp_path, name):
    dialect, write = SITUATIONS[name]
    topics = sent(sum(map(ord, name)), dialect)
    assert_the_same(write(tmp_path, topics), topics)


@pytest.mark.parametrize("name", ["mcap zstd", "mcap without chunks", "bag lz4", "db3 version 9, none"])
def test_table_rows_are_in_log_time_order(tmp_path, name):
    dialect, write = SITUATIONS[name]
    topics = sent(7, dialect, in_order=False)
    assert_the_same(write(tmp_path, topics), topics)


@pytest.mark.parametrize("dialect", ["ros1", "ros2"])
@pytest.mark.parametrize("seed", range(25))
def test_columns_equal_rosbags_for_random_definitions(tmp_path, seed, dialect):
    topics = sent(1000 + seed, dialect)
    assert_the_same(SITUATIONS["mcap none" if dialect == "ros2" else "mcap of ros1 none"][1](tmp_path, topics), topics)


@pytest.mark.soak
@pytest.mark.parametrize("dialect", ["ros1", "ros2"])
@pytest.mark.parametrize("seed", range(400))
def test_columns_equal_rosbags_for_many_random_definitions(tmp_path, seed, dialect):
    topics = sent(5000 + seed, dialect)
    assert_the_same(SITUATIONS["mcap none" if dialect == "ros2" else "mcap of ros1 none"][1](tmp_path, topics), topics)


@pytest.mark.parametrize("name", ["mcap zstd", "mcap without chunks", "bag", "db3 version 9, none"])
def test_open_reads_a_log_without_messages(tmp_path, name):
    dialect, write = SITUATIONS[name]
    with pytest.MonkeyPatch.context() as none:
        none.setattr("tests.logs.test_columns_against_rosbags.COUNT", 0)
        topics = [Sent("/t0", Messages(3, dialect, "test_msgs"), [])]
        path = write(tmp_path, topics)
    with logs.open(path) as log:
        assert [len(log[topic.name]) for topic in log.topics] in ([], [0])
