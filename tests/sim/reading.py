"""Read a recording back with rosbags: topic -> messages, with stamp (s since the start) and log time."""

from collections import defaultdict
from typing import NamedTuple

import cv2
import numpy as np
from rosbags.highlevel import AnyReader

from bodylog.sim.stage import START_NS


class Row(NamedTuple):
    t: float
    log_ns: int
    message: object


def seconds(stamp):
    return (stamp.sec * 10**9 + stamp.nanosec - START_NS) / 1e9


def stamp_of(message):
    if hasattr(message, "transforms"):
        return seconds(message.transforms[0].header.stamp)
    return seconds(message.header.stamp) if hasattr(message, "header") else 0.0


def read(path):
    topics = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            topics[connection.topic].append(Row(stamp_of(message), log_ns, message))
    return dict(topics)


def pictures(topics, camera="/camera"):
    """(stamp, BGR) of every frame."""
    if f"{camera}/image" in topics:
        rows = topics[f"{camera}/image"]
        return [(row.t, row.message.data.reshape(row.message.height, row.message.width, 3)[..., ::-1]) for row in rows]
    return [(row.t, cv2.imdecode(row.message.data, cv2.IMREAD_COLOR)) for row in topics[f"{camera}/image/compressed"]]


def pixels(topics, topic):
    """Stamp -> (u, v)."""
    return {row.t: np.array([row.message.point.x, row.message.point.y]) for row in topics.get(topic, [])}


def positions(topics, topic):
    """t (N,), values (N,M) in the order of the names, names."""
    rows = topics[topic]
    names = rows[0].message.name
    return np.array([row.t for row in rows]), np.array([row.message.position for row in rows]), list(names)
