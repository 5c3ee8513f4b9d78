"""Messages of ROS 1 of several types, one of them of nobody else's."""

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

CUSTOM = """Header header
time when
duration lasting
string[] names
float64[3] corner
custom_msgs/Cell[] cells
uint8[] raw
bool ready
char letter
===
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
===
MSG: custom_msgs/Cell
int32 id
float32[] prox
""".replace("===", "=" * 80)
KINDS = ("sensor_msgs/msg/JointState", "sensor_msgs/msg/CompressedImage", "custom_msgs/msg/Skin")


def ros1_store():
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register({k: v for k, v in get_types_from_msg(CUSTOM, KINDS[2]).items() if k.startswith("custom")})
    return store


def values(store, rng, i):
    """One message of each kind."""
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](1_700_000_000 + i, 5)
    header = types["std_msgs/msg/Header"](i, stamp, "base" * (i % 3))
    cells = [types["custom_msgs/msg/Cell"](j, rng.random(j).astype(np.float32)) for j in range(i % 4)]
    names, numbers = [f"j{k}" for k in range(i % 5)], rng.normal(size=i % 5)
    yield types[KINDS[0]](header, names, numbers, numbers, np.zeros(0))
    yield types[KINDS[1]](header, "jpeg", rng.integers(0, 256, 500 * i, dtype=np.uint8))
    span = types["builtin_interfaces/msg/Duration"](i, 7)
    corner, raw = rng.normal(size=3), rng.integers(0, 256, i, dtype=np.uint8)
    yield types[KINDS[2]](header, stamp, span, names, corner, cells, raw, i % 2 == 0, 65 + i)
