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


def tags(picture):
    """Number -> centre (2,) px of the tags that OpenCV finds: where a tag's diagonals meet."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, numbers, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(picture)
    return {} if numbers is None else {int(n): meet(c[0]) for n, c in zip(numbers.ravel(), corners, strict=True)}


def meet(square):
    a, b, c, d = square.astype(float)
    along = np.linalg.solve(np.array([c - a, b - d]).T, b - a)[0]
    return a + along * (c - a)
