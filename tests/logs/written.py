"""Features and estimates to write, logs to write them into, and other readers to read them back."""

import logging
from pathlib import Path

import numpy as np
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, IndexType, Writer
from pybag.mcap.record_reader import McapRecordReaderFactory
from rosbags.highlevel import AnyReader

from bodylog.annotating.messages import from_estimate, from_features
from bodylog.types import (
    Estimate,
    Fault,
    FaultKind,
    Features,
    Finding,
    Health,
    Poses,
    Series,
    Stroke,
    Synchrony,
    Touch,
)

START = 1_700_000_000_123_456_789
LATE = 4_000_000
JOINTS = ("shoulder", "elbow", "wrist")
logging.getLogger("pybag").setLevel(logging.ERROR)


def series(rng, ns, width, names, unit, hidden=0.0):
    values = rng.normal(size=(len(ns), width)) * 50 + 100
    values[rng.random(len(ns)) < hidden] = np.nan
    return Series(ns / 1e9, values, names, unit, START + ns + LATE, rng.uniform(0.1, 1.0, (len(ns), width)))


def covariance(rng, count, size):
    root = rng.normal(size=(count, size, size))
    return root @ root.transpose(0, 2, 1) + np.eye(size)


def effector(rng, joints):
    """Poses beside each row of the joints."""
    turn = rng.normal(size=(len(joints.t), 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    cov = covariance(rng, len(joints.t), 6)
    return Poses(joints.t, rng.normal(size=(len(turn), 3)), turn, "base_link", joints.source_ns, cov)


def found(seed=0, steps=300, frames=90):
    """Features and an estimate of a recording of a few seconds."""
    rng = np.random.default_rng(seed)
    ticks, pictures = np.arange(steps) * 10_000_000, np.arange(frames) * 33_333_333
    tracks = {name: series(rng, pictures, 2, ("u", "v"), "px", 0.3) for name in ("effector", "hand", "elbow-dot 1")}
    touches = tuple(
        Touch(i / 2, i / 2 + 0.25, tuple(range(i, 2 * i + 1)), float(np.float32(0.8)), 2 * i, START + i * 500_000_000)
        for i in range(4)
    )
    strokes = tuple(Stroke(i / 2 + 0.5, i / 2 + 0.75, (i, 2.5), (i + 10.0, 3.0)) for i in range(4))
    pairs = ((None, float("nan")), (0, 0.01), (2, 0.02), (3, -0.03))
    synchrony = tuple(Synchrony(i, stroke, delay, 0.2 * i) for i, (stroke, delay) in enumerate(pairs))
    joints = series(rng, ticks, 3, JOINTS, "rad")
    cov = covariance(rng, frames, 2)
    std = np.sqrt(np.stack([cov[:, 0, 0], cov[:, 1, 1]], 1))
    where = rng.uniform(0, 320, (frames, 2))
    predicted = Series(pictures / 1e9, where, ("u", "v"), "px", tracks["hand"].source_ns, std)
    features = Features(joints, tracks, touches, strokes, synchrony, {}, cameras={"": "/camera"})
    estimate = Estimate(
        method="filter",
        joints=joints,
        rate=series(rng, ticks, 3, JOINTS, "rad/s"),
        cov=covariance(rng, steps, 3),
        errors={
            "encoders": series(rng, ticks, 3, JOINTS, "std"),
            "effector": series(rng, pictures, 2, ("u", "v"), "std"),
        },
        free_energy=rng.normal(size=steps),
        used={"encoders": Health(steps, steps - 2, {"nan": 2}, 0.01), "effector": Health(frames, 60)},
        predicted={"effector": predicted},
        predicted_cov={"effector": cov},
        settings={"method": "filter", "rate": 100.0},
        bias=series(rng, ticks, 3, JOINTS, "rad"),
        faults=(
            Fault("encoders", "elbow", FaultKind.DRIFTING, 1.5, 0.25, "rad", 0.01),
            Fault("vision", "effector", FaultKind.DISPLACED, 2.0, 9.0, "px"),
            Fault("vision", "board", FaultKind.MOVED, 2.5, 0.003, "m", 0.0002, 0.04, 0.001),
        ),
        findings=(Finding("warning", "the elbow's encoder drifts"),),
        effector=effector(rng, joints),
        kinematic={"effector": series(rng, pictures, 2, ("u", "v"), "px")},
    )
    return features, estimate


def outgoing(seed=0, steps=300, frames=90):
    features, estimate = found(seed, steps, frames)
    return from_features(features, START) + from_estimate(estimate, features, START)


def amount(messages):
    return sum(len(o.log_ns) for o in messages)


POINT = b"float64 x\nfloat64 y\nfloat64 z\n"


def source(path: Path, seed=0, count=400, extras=True, padding=0, **options):
    """An MCAP by the mcap library: three topics, one of them empty, times not ascending, an attachment, metadata."""
    rng = np.random.default_rng(seed)
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 4096, "compression": CompressionType.LZ4, **options})
        writer.start("ros2", "someone else's recorder")
        schema = writer.register_schema("geometry_msgs/msg/Point", "ros2msg", POINT)
        qos = {"offered_qos_profiles": ""}
        topics = [writer.register_channel(topic, "cdr", schema, qos) for topic in ("/a", "/b", "/idle")]
        for i in range(count):
            log_ns = START + i * 7_000_000 + int(rng.integers(-20_000_000, 20_000_000))
            payload = b"\0\1\0\0" + rng.normal(size=3).tobytes() + bytes(padding)
            writer.add_message(topics[i % 2], log_ns, payload, log_ns - 1_000_000, sequence=i + 5)
        if extras:
            writer.add_attachment(START, START, "calibration.yaml", "text/yaml", b"focal: 600\n")
            writer.add_metadata("operator", {"name": "somebody", "robot": "ur5"})
        writer.finish()
    return path


UNSUITED = {
    "unchunked": {"use_chunking": False},
    "no summary": {
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
    "no message indexes": {"index_types": IndexType.CHUNK | IndexType.ATTACHMENT | IndexType.METADATA},
    "no repeated channels": {"repeat_channels": False},
    "unlisted extras": {"index_types": IndexType.CHUNK | IndexType.MESSAGE},
}
"""Ways to write an MCAP behind which nothing can be appended."""

Message = tuple[str, int, int, int, bytes]


def streamed(path: Path) -> list[Message]:
    """(topic, log time, publish time, sequence, payload) of every message, read from start to end."""
    with path.open("rb") as stream:
        found = NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        return sorted((c.topic, m.log_time, m.publish_time, m.sequence, bytes(m.data)) for _, c, m in found)


def sought(path: Path) -> list[Message]:
    """The same through the summary and the indexes."""
    with path.open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages()
        return sorted((c.topic, m.log_time, m.publish_time, m.sequence, bytes(m.data)) for _, c, m in found)


def by_rosbags(path: Path) -> list[tuple[str, int, bytes]]:
    """(topic, log time, payload) of every message, each decoded on the way."""
    found = []
    with AnyReader([path]) as reader:
        for connection, log_ns, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            found.append((connection.topic, log_ns, bytes(raw)))
    return sorted(found)


def by_pybag(path: Path) -> list[tuple[str, int, bytes]]:
    """(topic, log time, payload) of every message."""
    with McapRecordReaderFactory.from_file(path) as reader:
        topics = {number: channel.topic for number, channel in reader.get_channels().items()}
        return sorted((topics[m.channel_id], m.log_time, bytes(m.data)) for m in reader.get_messages())


def without_times(messages: list[Message]) -> list[tuple[str, int, bytes]]:
    return [(topic, log_ns, data) for topic, log_ns, _, _, data in messages]


def foreign(messages):
    """Messages that bodylog did not write."""
    return [message for message in messages if not message[0].startswith("/bodylog/")]
