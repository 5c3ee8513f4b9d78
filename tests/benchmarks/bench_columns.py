"""JointState at 500 Hz for ten minutes out of a zstd MCAP: ours, two public readers, and bare decompression."""

import mmap
import struct
import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from bodylog.logs.decode.columns import read_topic_columns
from bodylog.logs.formats import open_log
from bodylog.recording.recording import read_recording
from bodylog.settings import Settings
from bodylog.types import Array

from .goals import at_least, at_most
from .timing import side_by_side

_MESSAGES, _RATE, _SEED = 300_000, 500, 7
_NAMES = ("elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
_DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def main() -> None:
    """Print the times side by side and the three bounds they are held to."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "joints.mcap"
        _generate(path)
        print(f"{_MESSAGES} JointState, {path.stat().st_size / 1e6:.1f} MB zstd")
        times = side_by_side(
            "JointState to arrays",
            {
                "decompressing the chunks alone": lambda: _decompress(path),
                "bodylog columns": lambda: _ours(path),
                "bodylog whole recording": lambda: read_recording(path, Settings()),
                "rosbags decoded": lambda: _rosbags(path),
                "mcap_ros2 decoded": lambda: _mcap_ros2(path),
            },
            repeats=3,
            cpu=True,
        )
    floor, ours, _, rosbags, mcap_ros2 = times.values()
    what, own = f"{_MESSAGES:,} JointState to arrays", f"ours {ours:.3f} s"
    at_least(f"{what}, times faster than rosbags", rosbags / ours, 15, "", f"rosbags decoded, {rosbags:.2f} s; {own}")
    reported = f"mcap-ros2-support, {mcap_ros2:.2f} s; {own}"
    at_least(f"{what}, times faster than mcap_ros2", mcap_ros2 / ours, 30, "", reported)
    reported = f"decompressing its chunks, {floor:.3f} s; {own}"
    at_most(f"{what}, part of 2 × decompression + 0.1 s", ours / (2 * floor + 0.1), 1, "", reported)


def _generate(path: Path) -> None:
    rng = np.random.default_rng(_SEED)
    angles = np.cumsum(rng.normal(0, 1e-3, (_MESSAGES, len(_NAMES))), axis=0)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="bench")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", _DEFINITION.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for number in range(_MESSAGES):
            t = 1_700_000_000_000_000_000 + number * (1_000_000_000 // _RATE)
            writer.add_message(channel, t, _joint_state(t, angles[number]), t, number)
        writer.finish()


def _joint_state(t: int, angles: Array) -> bytes:
    out = bytearray(b"\0\1\0\0" + struct.pack("<iI", *divmod(t, 1_000_000_000)))
    for text in ("base", None, *_NAMES):
        out += b"\0" * (-len(out) % 4)
        held = b"" if text is None else text.encode() + b"\0"
        out += struct.pack("<I", len(_NAMES) if text is None else len(held)) + held
    for values in (angles, angles * 0, angles * 0):
        out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(values))
        out += b"\0" * ((4 - len(out)) % 8) + values.tobytes()
    return bytes(out)


def _decompress(path: Path) -> int:
    import zstandard

    total = 0
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        unpack = zstandard.ZstdDecompressor().decompress
        for chunk in summary.chunk_indexes:
            start = chunk.chunk_start_offset + 9 + 8 + 8 + 8 + 4 + 4 + len(chunk.compression) + 8
            total += len(unpack(data[start : start + chunk.compressed_size], max_output_size=chunk.uncompressed_size))
    return total


def _ours(path: Path) -> Array:
    with open_log(path) as log:
        found = read_topic_columns(log, log.topics[0], ("header.stamp", "name", "position"))
    assert (len(found.log_ns), found.fast, found.fallback) == (_MESSAGES, _MESSAGES, 0)
    return found.column("position")


def _rosbags(path: Path) -> Array:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        messages = (reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages())
        return np.array([message.position for message in messages])  # type: ignore[attr-defined]


def _mcap_ros2(path: Path) -> Array:
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return np.array([message.position for _, _, _, message in reader.iter_decoded_messages()])


if __name__ == "__main__":
    main()
