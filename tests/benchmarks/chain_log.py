"""The logs the whole chain is timed on: a minute of arm before a camera, ten minutes of what was seen of one."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from heapq import merge
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory

from bodylog import body
from bodylog.annotating import messages
from bodylog.body import storage as models
from bodylog.body_model import BodyModel
from bodylog.logs.decode.ros1_to_cdr import known_definition
from bodylog.logs.encode import cdr
from bodylog.logs.encode.cdr import CdrField
from bodylog.settings import Settings
from bodylog.types import Array, Outgoing, Series
from tests.annotating.annotated_logs import write_annotations
from tests.estimation.conftest import Arm, World, draw
from tests.perception import scenes

WIDTH, HEIGHT, CELLS = 640, 480, 117
START_NS = 1_700_000_000_000_000_000
_CAMERA_HZ, _ENCODER_HZ, _SKIN_HZ = 30.0, 500.0, 100.0
_STILL = ("wrist_1", "wrist_2", "wrist_3")
"""Joints that the driver publishes too, and that do not move."""

Row = tuple[int, str, bytes]
"""Log time (ns), topic, payload."""

Streams = Iterable[Iterator[Row]]


@dataclass(frozen=True)
class Wide(Arm):
    """The arm before a camera of 640×480."""

    def place(self, x: Array) -> Array:
        """u, v (...,2) px."""
        return np.array([200.0, 60.0]) + 2.0 * super().place(x)


def learn(path: Path) -> BodyModel:
    """Fit a body from 40 s of exploration, 320 pictures, and write it."""
    explored = draw(1, duration=40.0, camera_hz=8.0, encoder_hz=100.0, encoder_std=0.01, pixel_std=0.1, model=Wide())
    learned = body.learn_body([explored.features], Settings(), {}).model
    models.save(learned, path)
    return learned


def record(path: Path, kind: str, seconds: float) -> None:
    """Write a log as a recorder would, with a camera that publishes JPEGs, or raw pictures (in chunks by zstd)."""
    world = draw(2, seconds, _ENCODER_HZ, _CAMERA_HZ, 0.01, 0.0, Wide())
    streams = (_joints(world), _skin(seconds), _poses(world), _pictures(world, kind == "jpeg"))
    types = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/skin": "std_msgs/msg/Float32MultiArray",
        "/truth/pose": "geometry_msgs/msg/PoseStamped",
        "/camera": "sensor_msgs/msg/CompressedImage" if kind == "jpeg" else "sensor_msgs/msg/Image",
    }
    write(path, types, streams, CompressionType.NONE if kind == "raw" else CompressionType.ZSTD)


def write(path: Path, types: dict[str, str], streams: Streams, packed: CompressionType) -> None:
    """Write messages of streams, each in order of time; `types` has the type of each topic."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, compression=packed)
        writer.start("ros2", "benchmark")
        schemas = {
            topic: writer.register_schema(name, "ros2msg", known_definition(name) or b"")
            for topic, name in types.items()
        }
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic, schema in schemas.items()}
        for log_ns, topic, payload in merge(*streams):
            writer.add_message(channels[topic], log_ns, payload, log_ns)
        writer.finish()


def jpegs(path: Path) -> list[Array]:
    """The pictures of a log, (n,) uint8 each."""
    with path.open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/camera"])
        return [np.frombuffer(bytes(text.data), np.uint8) for *_, text in decoded]


def record_features(path: Path, seconds: float, encoder_hz: float) -> World:
    """Write a log that holds encoders, and what perception had found in the pictures it no longer has."""
    drawn = draw(3, seconds, encoder_hz, _CAMERA_HZ, 0.01, 0.3, Wide())
    features = drawn.features
    assert features.joints is not None
    joints = replace(features.joints, source_ns=messages.stamps_ns(features.joints.t, START_NS))
    tracks = {
        name: replace(track, source_ns=messages.stamps_ns(track.t, START_NS)) for name, track in features.tracks.items()
    }
    outgoing = messages.from_features(replace(features, tracks=tracks, cameras={"": "/camera"}), START_NS)
    write_annotations([messages.from_joints("/joint_states", joints, START_NS), *outgoing], {}, path)
    return drawn


def _joints(world: World) -> Iterator[Row]:
    """Six joints as a driver publishes them: three that the body is learned of, three that stay where they are."""
    found = world.features.joints
    assert found is not None
    values = np.hstack([found.values, np.tile([-1.2, 0.3, 0.0], (len(found.t), 1))])
    ns = messages.stamps_ns(found.t, START_NS)
    joints = Series(found.t, values, (*found.names, *_STILL), "rad", ns)
    made = messages.from_joints("/joint_states", joints, START_NS, np.gradient(values, found.t, axis=0))
    return rows(made.topic, made.log_ns, made)


def _skin(seconds: float) -> Iterator[Row]:
    """Proximity of all cells, as an array that has no header; nothing comes near."""
    t = np.arange(0.001, seconds, 1 / _SKIN_HZ)
    values = np.abs(np.random.default_rng(4).normal(0.0, 0.02, (len(t), CELLS)))
    fields: list[CdrField] = [("uint32", 0), ("uint32", 0), ("float32[]", values)]
    return rows("/skin", messages.stamps_ns(t, START_NS), cdr.serialise_messages(len(t), fields))


def _poses(world: World) -> Iterator[Row]:
    """Another topic of a real log, which nobody needs here."""
    t = np.arange(0.002, world.truth.t[-1], 1 / _SKIN_HZ)
    ns = messages.stamps_ns(t, START_NS)
    place = np.column_stack([np.sin(t), np.cos(t), 0 * t, 0 * t, 0 * t, 0 * t, 1 + 0 * t])
    fields: list[CdrField] = [*cdr.cdr_header_field(ns, "base_link"), ("float64*", place)]
    return rows("/truth/pose", ns, cdr.serialise_messages(len(t), fields))


def _pictures(world: World, compress: bool) -> Iterator[Row]:
    """A green disc where the effector is and a red one that wanders."""
    rng = np.random.default_rng(5)
    wall = scenes.wall(rng, WIDTH, HEIGHT, 5.0)
    track = world.features.tracks["effector"]
    for t, place in zip(track.t.tolist(), track.values.tolist(), strict=True):
        hand = (540.0 + 60.0 * np.cos(0.7 * t), 240.0 + 120.0 * np.sin(1.1 * t))
        discs = [scenes.Disc(place[0], place[1], 14.0), scenes.Disc(*hand, 18.0, scenes.RED)]
        picture, ns = scenes.draw(wall, discs, rng), int(messages.stamps_ns(np.array(t), START_NS))
        yield ns, "/camera", compressed(ns, scenes.jpeg(picture)) if compress else _raw(ns, picture)


def _raw(ns: int, picture: Array) -> bytes:
    fields: list[CdrField] = [
        *cdr.cdr_header_field(np.array([ns]), "camera"),
        ("uint32", HEIGHT),
        ("uint32", WIDTH),
        ("string", "rgb8"),
        ("uint8", 0),
        ("uint32", 3 * WIDTH),
        ("uint8[]", picture[:, :, ::-1].reshape(1, -1)),
    ]
    return cdr.serialise_messages(1, fields).data.tobytes()


def compressed(ns: int, jpeg: Array) -> bytes:
    """A CompressedImage of the bytes of a JPEG."""
    header = cdr.cdr_header_field(np.array([ns]), "camera")
    fields: list[CdrField] = [*header, ("string", "jpeg"), ("uint8[]", jpeg.reshape(1, -1))]
    return cdr.serialise_messages(1, fields).data.tobytes()


def rows(topic: str, ns: Array, payloads: cdr.Payloads | Outgoing) -> Iterator[Row]:
    """The messages of one topic, logged at ns (n,)."""
    whole = payloads.data.tobytes()
    for log_ns, offset, length in zip(ns.tolist(), payloads.offset.tolist(), payloads.length.tolist(), strict=True):
        yield log_ns, topic, whole[offset : offset + length]
