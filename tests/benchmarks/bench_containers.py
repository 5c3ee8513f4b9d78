"""Raw reading of whole logs, in batches and by message, beside other readers and the cost of unpacking alone."""

import ctypes
import mmap
import os
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from bodylog.logs.formats import open_log, payload_views
from bodylog.logs.mcap import opcodes as op
from bodylog.logs.mcap.chunks import chunk_head
from bodylog.logs.mcap.records import HEAD, MAGIC
from bodylog.logs.storage.compression import Buffer
from bodylog.logs.storage.mmapped import map_file
from tests.benchmarks.goals import at_least, at_most
from tests.benchmarks.timing import side_by_side

MESSAGES = 100_000
SMALL_EVERY, IMAGE_BYTES, IMAGES = 400, 921_600, 1_150
PERIOD_NS, START_NS = 2_000_000, 1_700_000_000_000_000_000
JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"


def joint_states(count: int) -> Iterator[tuple[int, bytes]]:
    """Log time and payload of `count` messages as long as a JointState of six joints."""
    values = np.random.default_rng(0).normal(size=(count, 18)).round(3)
    for number in range(count):
        yield START_NS + number * PERIOD_NS, b"\x00\x01\x00\x00" + bytes(96) + values[number].tobytes()


def write_mcap(path: Path, compression: str, chunked: bool = True) -> None:
    from mcap.writer import CompressionType, Writer

    writer = Writer(str(path), compression=CompressionType[compression], use_chunking=chunked)
    writer.start(profile="ros2", library="bench")
    schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", JOINT_STATE.encode())
    channel = writer.register_channel("/joint_states", "cdr", schema)
    for time, payload in joint_states(MESSAGES):
        writer.add_message(channel, time, payload, time)
    writer.finish()


def write_large(path: Path) -> None:
    """A 1 GB log of raw pictures with a small topic once every 400 of them."""
    from mcap.writer import CompressionType, Writer

    picture = np.random.default_rng(0).integers(0, 256, IMAGE_BYTES, np.uint8).tobytes()
    writer = Writer(str(path), compression=CompressionType.NONE)
    writer.start(profile="ros2", library="bench")
    schema = writer.register_schema("std_msgs/msg/UInt8", "ros2msg", b"uint8 data")
    large, small = (writer.register_channel(topic, "cdr", schema) for topic in ("/image", "/small"))
    for number in range(IMAGES):
        time = START_NS + number * 33_000_000
        writer.add_message(large, time, picture, time)
        if number % SMALL_EVERY == 0:
            writer.add_message(small, time, b"\x00\x01\x00\x00\x07", time)
    writer.finish()


def write_bag(path: Path) -> None:
    from rosbags.rosbag1 import Writer

    bag = Writer(path)
    bag.set_compression(Writer.CompressionFormat.LZ4)
    with bag as writer:
        connection = writer.add_connection(
            "/joint_states", "sensor_msgs/msg/JointState", msgdef=JOINT_STATE, md5sum="3066dcd76a6cfaef579bd0f34173e9fd"
        )
        for time, payload in joint_states(MESSAGES):
            writer.write(connection, time, payload)


def write_db3(path: Path) -> None:
    from fixtures.by_hand import db3

    some = [("/joint_states", time, payload) for time, payload in joint_states(MESSAGES)]
    db3(path, some, "sensor_msgs/msg/JointState", None)


def unpack_only(path: Path) -> int:
    """The floor: unpack every chunk and check its CRC, nothing else."""
    data, buffer, at, total = map_file(path), Buffer(), len(MAGIC), 0
    while at < len(data) - len(MAGIC):
        opcode, length = HEAD.unpack_from(data, at)
        if opcode == op.CHUNK:
            _, _, size, _, compression, packed = chunk_head(data, at)
            total += zlib.crc32(buffer.load(compression, packed, size).data) & 1
        at += HEAD.size + length
    return total


def in_batches(path: Path) -> int:
    with open_log(path) as log:
        return sum(len(batch.log_ns) for batch in log.batches())


def by_message(path: Path) -> int:
    count = 0
    with open_log(path) as log:
        for batch in log.batches():
            for _time, _payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
                count += 1
    return count


def mcap_seeking(path: Path) -> int:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages(log_time_order=False))


def mcap_streaming(path: Path) -> int:
    from mcap.reader import NonSeekingReader

    with path.open("rb") as stream:
        return sum(1 for _ in NonSeekingReader(stream).iter_messages(log_time_order=False))


def rosbags_raw(path: Path) -> int:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        return sum(1 for _ in reader.messages())


def rosbag1_raw(path: Path) -> int:
    from rosbags.rosbag1 import Reader

    with Reader(path) as reader:
        return sum(1 for _ in reader.messages())


def small_topic(path: Path) -> int:
    with open_log(path) as log:
        wanted = [topic.id for topic in log.topics if topic.name == "/small"]
        return sum(len(batch.log_ns) for batch in log.batches(wanted))


def small_topic_mcap(path: Path) -> int:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages(topics=["/small"]))


def small_topic_rosbags(path: Path) -> int:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == "/small"]
        return sum(1 for _ in reader.messages(connections=wanted))


def read_from_disk(path: Path, case: Callable[[Path], int]) -> int:
    """Bytes of the file the kernel brought in for this reading, read-ahead included."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
        before = _resident(handle)
        case(path)
        return _resident(handle) - before
    finally:
        os.close(handle)


def _resident(handle: int) -> int:
    size = os.fstat(handle).st_size
    with mmap.mmap(handle, size, mmap.MAP_PRIVATE, mmap.PROT_READ | mmap.PROT_WRITE) as window:
        pages = (ctypes.c_ubyte * -(-size // mmap.PAGESIZE))()
        start = ctypes.c_char.from_buffer(window)
        ctypes.CDLL(None).mincore(ctypes.c_void_p(ctypes.addressof(start)), ctypes.c_size_t(size), pages)
        del start
        return sum(page & 1 for page in bytes(pages)) * mmap.PAGESIZE


def main() -> None:
    """Write the logs, time every reader on each."""
    with tempfile.TemporaryDirectory(prefix="bodylog-bench-") as name:
        folder = Path(name)
        for compression in ("ZSTD", "LZ4", "NONE"):
            path = folder / f"{compression}.mcap"
            write_mcap(path, compression)
            _compare(f"{MESSAGES} messages, MCAP {compression.lower()}", path, True)
        write_mcap(folder / "unchunked.mcap", "NONE", chunked=False)
        _compare(f"{MESSAGES} messages, MCAP without chunks", folder / "unchunked.mcap", False, 3)
        write_bag(folder / "lz4.bag")
        _versus(f"{MESSAGES} messages, ROS 1 bag lz4", folder / "lz4.bag", {"rosbags raw": rosbag1_raw})
        write_db3(folder / "x.db3")
        _versus(f"{MESSAGES} messages, db3", folder / "x.db3", {"rosbags raw": rosbags_raw}, 3)
        write_large(folder / "large.mcap")
        _small(folder / "large.mcap")


def _compare(title: str, path: Path, floor: bool, least: float | None = None) -> None:
    others = {"mcap seeking": mcap_seeking, "mcap streaming": mcap_streaming, "rosbags raw": rosbags_raw}
    _versus(title, path, {**({"unpacking and CRC alone": unpack_only} if floor else {}), **others}, least)


def _versus(title: str, path: Path, others: dict[str, Callable[[Path], int]], least: float | None = None) -> None:
    cases = {"bodylog in batches": in_batches, "bodylog by message": by_message, **others}
    assert {case(path) for case in cases.values() if case is not unpack_only} == {MESSAGES}
    runs = {label: (lambda case=case: case(path)) for label, case in cases.items()}
    took = side_by_side(title, runs, repeats=3, cpu=True)
    if least is not None:
        for label in ("bodylog in batches", "bodylog by message"):
            ratio = took["rosbags raw"] / took[label]
            text = f"rosbags raw, {took['rosbags raw'] * 1e3:.0f} ms; ours {took[label] * 1e3:.0f} ms"
            at_least(f"{title}, {label.removeprefix('bodylog ')}, times faster than rosbags", ratio, least, "", text)


def _small(path: Path) -> None:
    cases = {"bodylog": small_topic, "mcap": small_topic_mcap, "rosbags": small_topic_rosbags}
    title = f"one small topic of a {path.stat().st_size / 1e9:.2f} GB log"
    runs = {label: (lambda case=case: case(path)) for label, case in cases.items()}
    took = side_by_side(title, runs, repeats=9, cpu=True)
    brought = {label: read_from_disk(path, case) / 1e6 for label, case in cases.items()}
    for label, megabytes in brought.items():
        print(f"  {label:<52} {megabytes:10.1f} MB brought in from the file")
    text = f"mcap's seeking reader, {took['mcap'] * 1e3:.1f} ms; ours {took['bodylog'] * 1e3:.1f} ms"
    at_most(f"{title}, times mcap's reader", took["bodylog"] / took["mcap"], 1, "", text)
    text = f"mcap's seeking reader, {brought['mcap']:.1f} MB"
    at_most(f"{title}, brought in from the file", brought["bodylog"], brought["mcap"], "MB", text)


if __name__ == "__main__":
    main()
