"""Other readers of the same files: every message of each, as a multiset of (topic, log time, payload)."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from bodylog.logs.formats import open_log, payload_views

Messages = Counter[tuple[str, int, bytes]]


def ours(path: Path) -> Messages:
    found: Messages = Counter()
    with open_log(path) as log:
        names = {topic.id: topic.name for topic in log.topics}
        for batch in log.batches():
            name = names[batch.topic_id]
            for time, payload in zip(batch.log_ns.tolist(), payload_views(batch), strict=True):
                found[name, time, bytes(payload)] += 1
    return found


def mcap_seeking(path: Path) -> Messages:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        found = make_reader(stream).iter_messages()
        return Counter((channel.topic, message.log_time, message.data) for _, channel, message in found)


def mcap_streaming(path: Path) -> Messages:
    """Messages of the streaming reader until it fails: it is the reader for truncated files."""
    from mcap.reader import NonSeekingReader

    found: Messages = Counter()
    with path.open("rb") as stream:
        try:
            for _, channel, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
                found[channel.topic, message.log_time, message.data] += 1
        except Exception:  # a damaged file: messages before the damage count
            return found
    return found


def rosbags_raw(path: Path) -> Messages:
    """Nothing is decoded, so missing types do not matter."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        return Counter((connection.topic, time, bytes(raw)) for connection, time, raw in reader.messages())


def pybag_raw(path: Path) -> Messages:
    from pybag.mcap.record_reader import McapRecordReaderFactory

    reader = McapRecordReaderFactory.from_file(path)
    try:
        channels = reader.get_channels()
        found = reader.get_messages(list(channels), in_log_time_order=False)
        return Counter((channels[one.channel_id].topic, one.log_time, bytes(one.data)) for one in found)
    finally:
        reader.close()


def pybag_counts(path: Path) -> Counter[str]:
    """Messages per topic of a ROS 1 bag, none when pybag refuses it."""
    from pybag.bag_reader import BagFileReader

    try:
        with BagFileReader.from_file(path) as reader:
            return Counter({topic: reader.get_message_count(topic) for topic in reader.get_topics()})
    except Exception:  # as in whatever()
        return Counter()


def sqlite_raw(path: Path) -> Messages:
    import sqlite3
    from contextlib import closing

    query = "SELECT name, timestamp, data FROM messages JOIN topics ON topic_id = topics.id"
    with closing(sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)) as store:
        return Counter((name, time, bytes(data)) for name, time, data in store.execute(query))


def whatever(reader: Callable[[Path], Messages], path: Path) -> Messages:
    """Messages of a reader, none when it refuses the file."""
    try:
        return Counter({(topic, time, _plain(raw)): count for (topic, time, raw), count in reader(path).items()})
    except Exception:  # each refuses some of these files with its own exception
        return Counter()


def _plain(raw: bytes) -> bytes:
    """rosbag2 may compress single messages; the readers leave that to their user."""
    import zstandard

    return zstandard.ZstdDecompressor().decompress(raw) if raw.startswith(b"\x28\xb5\x2f\xfd") else raw
