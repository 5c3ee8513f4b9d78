"""Memory of reading one topic of a 2 GB log, beyond the arrays that are read, and of estimating an hour."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from tests.benchmarks.bench_columns import _DEFINITION, _joint_state
from tests.benchmarks.goals import at_most

_GB, _PICTURE, _PER_PICTURE = 2.0, 921_600, 16
_LIMIT_MB = 150.0
_CHILD = """
import re, sys, threading, time
import bodylog.logs as logs

def now(name):
    return int(re.search(name + r":\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1e3

most = {"VmRSS": 0.0, "RssAnon": 0.0}
def watch():
    while True:
        for name in most:
            most[name] = max(most[name], now(name))
        time.sleep(0.002)

import numpy
before = {name: now(name) for name in most}
threading.Thread(target=watch, daemon=True).start()
found = logs.read(sys.argv[1], {"/joint_states": ["header.stamp", "name", "position", "velocity", "effort"]})
table = found["/joint_states"]
arrays = {name: table[name] for name in ("header.stamp", "position", "velocity", "effort")}
time.sleep(0.02)
size = sum(array.nbytes for array in arrays.values()) / 1e6
print(len(table), size, *(most[name] - before[name] for name in most))
"""
_HOUR = """
import resource, sys
from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings
from tests.benchmarks.bench_estimation import learned
from tests.estimation.conftest import draw

hour = draw(2, duration=3600.0, encoder_hz=100.0, camera_hz=30.0, encoder_std=0.01, pixel_std=0.3).features
estimate_from_features(hour, learned(120), EstimationSettings(method=sys.argv[1]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9)
"""


def main() -> None:
    """Print peak resident memory, of that what is not mapped file, and the result's size, as chunks are stored."""
    for method in ("filter", "smoother"):
        command = [sys.executable, "-c", _HOUR, method]
        most = float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        at_most(f"peak memory of `{method}`, an hour of three joints with pictures", most, 1.0, "GB", "all of the process")
    for compression in ("NONE", "LZ4"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "large.mcap"
            _write(path, compression)
            command = [sys.executable, "-c", _CHILD, str(path)]
            printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            count, result, resident, anonymous = map(float, printed.split())
            gigabytes = path.stat().st_size / 1e9
        size = f"{count:.0f} messages of {gigabytes:.1f} GB, {compression.lower()}, arrays of {result:.0f} MB"
        print(f"\n{size}: peak {resident:.0f} MB, of that {anonymous:.0f} MB not mapped file")
        what = f"peak memory of `read` on one topic of a 2 GB log beyond its arrays, {compression.lower()} chunks"
        at_most(what, resident - result, _LIMIT_MB, "MB", f"{anonymous - result:.0f} MB of it not mapped file")


def _write(path: Path, compression: str) -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, _PICTURE, np.uint8).tobytes() for _ in range(4)]
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType[compression])
        writer.start(profile="ros2", library="bench")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", _DEFINITION.encode())
        joints = writer.register_channel("/joint_states", "cdr", schema)
        raw = writer.register_schema("std_msgs/msg/UInt8", "ros2msg", b"uint8 data")
        camera = writer.register_channel("/camera", "cdr", raw)
        for number in range(int(_GB * 1e9 / _PICTURE)):
            t = 1_700_000_000_000_000_000 + number * 33_000_000
            writer.add_message(camera, t, pictures[number % 4], t)
            for k in range(_PER_PICTURE):
                stamp = t + k * 2_000_000
                writer.add_message(joints, stamp, _joint_state(stamp, rng.normal(size=6)), stamp)
        writer.finish()


if __name__ == "__main__":
    main()
