"""The chain as one would script it with the usual libraries: mcap, mcap_ros2, OpenCV's functions, an EKF in numpy."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.decoder import DecoderFactory

from bodylog.body_model import BodyModel
from bodylog.logs.encode.schemas import ros2msg_definition
from bodylog.perception.colours import hsv_ranges
from bodylog.types import Array

_EVERY = 5
"""Of 500 beliefs per second, 100 are written."""


class Filter:
    """An extended Kalman filter over the angles and rates of M joints; the effector's place by the learned body."""

    def __init__(self, model: BodyModel, start: Array) -> None:
        """Begin at the first reading of the encoders."""
        m = len(model.joints)
        self.sense, self.eye = model.senses["effector"], np.eye(2 * m)
        self.x, self.p = np.concatenate([start, np.zeros(m)]), np.eye(2 * m)
        self.h, self.r = np.eye(m, 2 * m), np.diag(model.noise.encoder)
        self.pixel, self.q = np.diag(model.noise.senses["effector"]), np.diag(model.noise.process)
        self.m, self.t = m, None

    def to(self, t: float) -> None:
        """Predict."""
        dt, self.t = 0.0 if self.t is None else t - self.t, t
        f = self.eye.copy()
        f[: self.m, self.m :] = dt * np.eye(self.m)
        self.x, self.p = f @ self.x, f @ self.p @ f.T
        self.p[: self.m, : self.m] += self.q * dt**3 / 3
        self.p[: self.m, self.m :] += self.q * dt**2 / 2
        self.p[self.m :, : self.m] += self.q * dt**2 / 2
        self.p[self.m :, self.m :] += self.q * dt

    def read(self, angles: Array) -> None:
        """Encoders (M,) rad."""
        self._update(angles - self.x[: self.m], self.h, self.r)

    def see(self, place: Array) -> Array:
        """Effector (2,) px; what it was not expected to be (2,) px."""
        mean, slope, spread = self.sense.predict_one(self.x[: self.m])
        h = np.zeros((2, 2 * self.m))
        h[:, : self.m] = slope
        self._update(place - mean, h, self.pixel + np.diag(spread))
        return place - mean

    def _update(self, surprise: Array, h: Array, r: Array) -> None:
        seen = h @ self.p
        gain = np.linalg.solve(seen @ h.T + r, seen).T
        self.x, p = self.x + gain @ surprise, self.p - gain @ seen
        self.p = (p + p.T) / 2  # without this, rounding grows over the 30,000 steps


class Output:
    """The annotated log: the messages as they were, and ours among them."""

    def __init__(self, writer: Writer) -> None:
        """Begin a ROS 2 log."""
        self.writer = writer
        writer.start("ros2", "script")
        self._schemas: dict[int, int] = {}
        self._copied: dict[int, int] = {}
        self._made: dict[str, tuple[int, Callable[[Any], bytes]]] = {}

    def copy(self, schema: Any, channel: Any, message: Any) -> None:
        """One message of the log."""
        if channel.id not in self._copied:
            if schema.id not in self._schemas:
                self._schemas[schema.id] = self.writer.register_schema(schema.name, schema.encoding, schema.data)
            number = self._schemas[schema.id]
            self._copied[channel.id] = self.writer.register_channel(channel.topic, channel.message_encoding, number)
        number = self._copied[channel.id]
        self.writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)

    def put(self, topic: str, kind: str, ns: int, **fields: Any) -> None:
        """One message of ours, with a header."""
        if topic not in self._made:
            text = ros2msg_definition(kind)
            channel = self.writer.register_channel(topic, "cdr", self.writer.register_schema(kind, "ros2msg", text))
            self._made[topic] = channel, serialize_dynamic(kind, text.decode())[kind]
        channel, encode = self._made[topic]
        header = {"stamp": {"sec": ns // 1_000_000_000, "nanosec": ns % 1_000_000_000}, "frame_id": ""}
        self.writer.add_message(channel, ns, encode({"header": header, **fields}), ns)


def run(log: Path, model: BodyModel, out: Path, compression: CompressionType) -> Array:
    """Replay a log in one pass and write it with the belief in it; the last angles (M,) rad."""
    wanted = {"effector": hsv_ranges.resolve_colour("green", "effector"), "hand": hsv_ranges.resolve_colour("red", "hand")}
    belief, count = None, 0
    with log.open("rb") as source, out.open("wb") as target:
        output = Output(Writer(target, compression=compression))
        reader = make_reader(source, decoder_factories=[DecoderFactory()])
        for schema, channel, message, reported in reader.iter_decoded_messages():
            output.copy(schema, channel, message)
            t = message.log_time / 1e9
            if channel.topic == "/joint_states":
                angles = np.array([reported.position[reported.name.index(name)] for name in model.joints])
                belief = belief or Filter(model, angles)
                belief.to(t)
                belief.read(angles)
                count += 1
                if count % _EVERY == 0:
                    _put_belief(output, message.log_time, model, belief)
            elif channel.topic == "/camera" and belief is not None:
                belief.to(t)
                _look(output, message.log_time, reported, wanted, belief)
        output.writer.finish()
    assert belief is not None
    return np.asarray(belief.x[: belief.m])


def _put_belief(output: Output, ns: int, model: BodyModel, belief: Filter) -> None:
    names, m = list(model.joints), belief.m
    angles, rates = belief.x[:m].tolist(), belief.x[m:].tolist()
    joints = {"name": names, "position": angles, "velocity": rates, "effort": [0.0] * m}
    output.put("/script/joint_states", "sensor_msgs/msg/JointState", ns, **joints)
    covariance = belief.p[:m, :m].ravel().tolist()
    output.put("/script/joint_covariance", "bodylog_msgs/msg/Covariance", ns, names=names, data=covariance)


def _look(output: Output, ns: int, reported: Any, wanted: dict[str, hsv_ranges.HsvRange], belief: Filter) -> None:
    for name, place in find(_picture(reported), wanted).items():
        point = {"x": float(place[0]), "y": float(place[1]), "z": 0.0}
        output.put(f"/script/{name}", "geometry_msgs/msg/PointStamped", ns, point=point)
        if name == "effector":
            error = belief.see(place).tolist()
            output.put("/script/error", "bodylog_msgs/msg/Vector", ns, names=["u", "v"], data=error)


def _picture(reported: Any) -> Array:
    if hasattr(reported, "format"):
        return np.asarray(cv2.imdecode(np.frombuffer(reported.data, np.uint8), cv2.IMREAD_COLOR))
    picture = np.frombuffer(reported.data, np.uint8).reshape(reported.height, reported.width, 3)
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))


def find(picture: Array, wanted: dict[str, hsv_ranges.HsvRange]) -> dict[str, Array]:
    """The centroid (2,) px of each colour's largest component, where there is one."""
    hsv, found = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV), {}
    for name, colour in wanted.items():
        count, _, stats, centroids = cv2.connectedComponentsWithStats(hsv_ranges.mask_of_range(hsv, colour))
        if count > 1:
            found[name] = centroids[1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))]
    return found
