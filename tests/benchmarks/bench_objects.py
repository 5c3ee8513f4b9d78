"""A field of JSON and protobuf messages as an array, beside readers that decode message by message."""

import json
import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

import bodylog.logs as logs
from bodylog.types import Array
from tests.benchmarks.goals import at_least
from tests.benchmarks.timing import side_by_side

_MESSAGES, _LEAST = 60_000, 5.0
_START = 1_700_000_000_000_000_000
_NAMES = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
_TOPIC = "/joint_states"


def main() -> None:
    """Print the times side by side and the bound: both read the positions of six joints."""
    with tempfile.TemporaryDirectory() as folder:
        for kind, decode in (("json", _by_json), ("protobuf", _by_protobuf)):
            path = Path(folder) / f"{kind}.mcap"
            _write(path, kind)
            cases = {
                "bodylog": lambda path=path: _ours(path),
                "mcap, message by message": lambda path=path, decode=decode: decode(path),
                "bodylog, message by message": lambda path=path: _one_by_one(path),
            }
            found = [case() for case in cases.values()]
            assert all(np.array_equal(found[0], other) for other in found)
            size = f"{path.stat().st_size / 1e6:.0f} MB"
            ours, peer, _ = side_by_side(f"{_MESSAGES} {kind} messages, {size}", cases, 3, cpu=True).values()
            library = {"json": "mcap and json.loads", "protobuf": "mcap-protobuf-support"}[kind]
            text = f"{library}, {peer / _MESSAGES * 1e6:.1f} µs a message; ours {ours / _MESSAGES * 1e6:.2f} µs"
            at_least(f"a {kind} column, times faster than message by message", peer / ours, _LEAST, "", text)


def _ours(path: Path) -> Array:
    with logs.open(path) as log:
        return log.read({_TOPIC: ["position"]})[_TOPIC]["position"]


def _one_by_one(path: Path) -> Array:
    with logs.open(path) as log:
        return np.array([message.value["position"] for message in log.messages()])


def _by_json(path: Path) -> Array:
    with path.open("rb") as stream:
        return np.array([json.loads(message.data)["position"] for _, _, message in make_reader(stream).iter_messages()])


def _by_protobuf(path: Path) -> Array:
    from mcap_protobuf.decoder import DecoderFactory

    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return np.array([message.position for _, _, _, message in reader.iter_decoded_messages()])


def _write(path: Path, kind: str) -> None:
    """Joint states at 500 Hz: header, names, and three arrays of full precision."""
    rng, (build, schema) = np.random.default_rng(0), _BUILDERS[kind]()
    angles = np.cumsum(rng.normal(0, 1e-3, (_MESSAGES, len(_NAMES))), axis=0)
    rates, efforts = rng.normal(size=(2, _MESSAGES, len(_NAMES)))
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start("", "benchmark")
        number = writer.register_schema("robot.JointState", {"json": "jsonschema"}.get(kind, kind), schema)
        channel = writer.register_channel(_TOPIC, kind, number)
        for i in range(_MESSAGES):
            t = _START + i * 2_000_000
            writer.add_message(channel, t, build(t, angles[i].tolist(), rates[i].tolist(), efforts[i].tolist()), t)
        writer.finish()


def _json():  # type: ignore[no-untyped-def]
    def build(t: int, position: list[float], velocity: list[float], effort: list[float]) -> bytes:
        stamp = {"sec": t // 10**9, "nanosec": t % 10**9}
        arrays = {"position": position, "velocity": velocity, "effort": effort}
        return json.dumps({"header": {"stamp": stamp, "frame_id": "base"}, "name": _NAMES, **arrays}).encode()

    return build, b'{"type": "object"}'


def _protobuf():  # type: ignore[no-untyped-def]
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="joints.proto", package="robot", syntax="proto3")
    time = file.message_type.add(name="Time")
    time.field.add(name="sec", number=1, type=5, label=1)
    time.field.add(name="nsec", number=2, type=13, label=1)
    state = file.message_type.add(name="JointState")
    state.field.add(name="stamp", number=1, type=11, label=1, type_name=".robot.Time")
    state.field.add(name="name", number=2, type=9, label=3)
    for number, name in enumerate(("position", "velocity", "effort"), 3):
        state.field.add(name=name, number=number, type=1, label=3)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("robot.JointState"))

    def build(t: int, position: list[float], velocity: list[float], effort: list[float]) -> bytes:
        message = kind(name=_NAMES, position=position, velocity=velocity, effort=effort)
        message.stamp.sec, message.stamp.nsec = divmod(t, 10**9)
        return bytes(message.SerializeToString())

    return build, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


_BUILDERS = {"json": _json, "protobuf": _protobuf}

if __name__ == "__main__":
    main()
