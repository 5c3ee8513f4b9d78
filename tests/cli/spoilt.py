"""Recorded logs with their joints' messages changed one by one, by other libraries than ours; all else as it was."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

KIND = "sensor_msgs/msg/JointState"
SECOND = 10**9

Change = Callable[[int, Any], bool]
"""Changes the n-th joint message, whose position is a list; says whether it is to be kept."""


def spoil(
    source: Path, out: Path, change: Change, until: float = 1e9, kept: Callable[[str], bool] = lambda topic: True
) -> Path:
    """Write the first `until` s of a log (.mcap or .bag) with its joints changed and only the topics `kept`."""
    (_mcap if source.suffix == ".mcap" else _bag)(source, out, change, until, kept)
    return out


def later(message: Any, seconds: float) -> None:
    """Move a message's stamp."""
    stamp = message.header.stamp
    total = stamp.sec * SECOND + stamp.nanosec + round(seconds * SECOND)
    stamp.sec, stamp.nanosec = divmod(total, SECOND)


def _mcap(source: Path, out: Path, change: Change, until: float, kept: Callable[[str], bool]) -> None:
    from mcap.reader import make_reader
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    store, channels, count = get_typestore(Stores.ROS2_HUMBLE), {}, -1
    with source.open("rb") as read, out.open("wb") as written:
        writer = Writer(written)
        writer.start("ros2", "spoilt")
        started = None
        for schema, channel, message in make_reader(read).iter_messages():
            started = message.log_time if started is None else started
            if message.log_time - started > until * SECOND or not kept(channel.topic):
                continue
            data = message.data
            if _spoken(channel.topic):
                record = store.deserialize_cdr(data, KIND)
                if not _changed(change, count := count + 1, record):
                    continue
                data = bytes(store.serialize_cdr(record, KIND))
            if channel.topic not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, known)
            writer.add_message(channels[channel.topic], message.log_time, data, message.publish_time)
        writer.finish()


def _bag(source: Path, out: Path, change: Change, until: float, kept: Callable[[str], bool]) -> None:
    from rosbags.rosbag1 import Reader, Writer
    from rosbags.typesys import Stores, get_typestore

    store, connections, count = get_typestore(Stores.ROS1_NOETIC), {}, -1
    with Reader(source) as reader, Writer(out) as writer:
        for connection, time, data in reader.messages():
            topic, kind = connection.topic, connection.msgtype
            if time - reader.start_time > until * SECOND or not kept(topic):
                continue
            if _spoken(topic):
                record = store.deserialize_ros1(data, KIND)
                if not _changed(change, count := count + 1, record):
                    continue
                data = bytes(store.serialize_ros1(record, KIND))
            if topic not in connections:
                definition, digest = connection.msgdef.data, connection.digest
                connections[topic] = writer.add_connection(topic, kind, msgdef=definition, md5sum=digest)
            writer.write(connections[topic], time, data)


def _changed(change: Change, count: int, record: Any) -> bool:
    """Whether the message is kept; its position can be written to."""
    record.position = record.position.copy()
    return change(count, record)


def _spoken(topic: str) -> bool:
    return topic.endswith("joint_states") and "truth" not in topic
