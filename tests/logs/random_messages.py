"""Random message definitions of ROS 1 and ROS 2, messages of them by rosbags, and their values."""

import random
from collections.abc import Iterator
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_INTEGERS = {f"{sign}int{bits}": (sign, bits) for sign in ("", "u") for bits in (8, 16, 32, 64)}
_PLAIN = ("bool", "byte", "char", "float32", "float64", "string", *_INTEGERS)
_STAMPS = {"ros1": ("time", "duration"), "ros2": ("builtin_interfaces/Time", "builtin_interfaces/Duration")}
_CONSTANTS = ("int32 SEVEN=7", "string TEXT=a # b", "float64 HALF=0.5", "uint8 NONE = 0  # of nothing", "bool YES=1")
_SIZES = {"ros1": ("", "", "", "[]", "[3]", "[1]"), "ros2": ("", "", "", "[]", "[3]", "[1]", "[<=4]")}


class Messages:
    """One definition of three nested types, by seed; `text` is its definition for a log."""

    def __init__(self, seed: int, dialect: str, package: str) -> None:
        """dialect: ros1 or ros2; `root` is the type of the messages, in that package."""
        self._draw, self.dialect, self.root = random.Random(seed), dialect, f"{package}/msg/Root"
        self.store = get_typestore(Stores.ROS1_NOETIC if dialect == "ros1" else Stores.ROS2_HUMBLE)
        leaf, inner = f"{package}/Leaf", f"{package}/Inner"
        bodies = [self._body(()), self._body((leaf,)), self._body((leaf, inner))]
        for name, body in zip(("Leaf", "Inner", "Root"), bodies, strict=True):
            self.store.register(get_types_from_msg(body, f"{package}/msg/{name}"))
        rule = "=" * 80
        self.text = f"{bodies[2]}{rule}\nMSG: {inner}\n{bodies[1]}{rule}\nMSG: {leaf}\n{bodies[0]}"

    def payload(self) -> bytes:
        """A random message as the dialect writes it."""
        message = self._message(self.root)
        if self.dialect == "ros1":
            return bytes(self.store.serialize_ros1(message, self.root))
        return bytes(self.store.serialize_cdr(message, self.root, little_endian=self._draw.random() < 0.9))

    def _body(self, inner: tuple[str, ...]) -> str:
        draw, kinds = self._draw, (*_PLAIN, *_STAMPS[self.dialect], "std_msgs/Header", *inner, *inner)
        lines = draw.sample(_CONSTANTS, draw.randrange(3))
        for number in range(draw.randrange(1, 6)):
            kind, size = draw.choice(kinds), draw.choice(_SIZES[self.dialect])
            bound = "<=9" if kind == "string" and self.dialect == "ros2" and draw.random() < 0.3 else ""
            default = " 3" if self.dialect == "ros2" and kind in _INTEGERS and not size and draw.random() < 0.2 else ""
            lines.append(f"{kind}{bound}{size} f{number}{default}  # a remark")
        return "\n".join(lines) + "\n"

    def _message(self, type_: str) -> Any:
        if type_ == "builtin_interfaces/msg/Time":  # none before 1970: past 2038 the seconds continue as unsigned
            return self.store.types[type_](self._draw.randrange(1 << 31), self._draw.randrange(10**9))
        _, fields = self.store.fielddefs[type_]
        return self.store.types[type_](**{name: self._value(of) for name, of in fields})

    def _value(self, of: Any) -> Any:
        kind, rest = of
        if kind.name == "BASE":
            return self._plain(rest[0])
        if kind.name == "NAME":
            return self._message(rest)
        inner, bound = rest
        count = bound if kind.name == "ARRAY" else self._draw.choice((0, 1, 2, 2, 2, 3))
        some = [self._value(inner) for _ in range(count)]
        plain = inner[0].name == "BASE" and inner[1][0] != "string"
        return np.array(some, _dtype(inner[1][0])) if plain else some

    def _plain(self, name: str) -> Any:
        draw = self._draw
        if name == "string":
            return draw.choice(("", "a", "joint_1", "joint_1", "käse"))
        if name == "bool":
            return draw.random() < 0.5
        if name.startswith("float"):
            return float(np.dtype(name).type(draw.choice((draw.gauss(0, 1), 0.0, float("nan"), float("inf")))))
        sign, bits = _INTEGERS.get(name, ("u", 7))
        low, high = (0, 1 << bits) if sign else (-(1 << bits - 1), 1 << bits - 1)
        return draw.choice((low, high - 1, draw.randrange(low, high), 1))


def _dtype(name: str) -> str:
    return {"byte": "uint8", "char": "uint8"}.get(name, name)


def values(message: Any, path: str) -> list[Any]:
    """The plain values at a path in a message of rosbags, times in ns."""
    return list(_values(message, path.split(".")))


def _values(value: Any, steps: list[str]) -> Iterator[Any]:
    if isinstance(value, list | tuple | np.ndarray):
        for item in value.tolist() if isinstance(value, np.ndarray) else value:
            yield from _values(item, steps)
    elif steps:
        yield from _values(getattr(value, steps[0].removesuffix("[:]")), steps[1:])
    elif hasattr(value, "sec"):
        yield value.sec * 1_000_000_000 + value.nanosec
    else:
        yield value


def assert_row(row: Any, expected: list[Any], what: str) -> None:
    """Assert that a row of a table holds these values, padded with NaN or ""."""
    found = list(row) if isinstance(row, bytes) else np.atleast_1d(row).tolist()
    head, tail = found[: len(expected)], found[len(expected) :]
    assert len(found) >= len(expected) and all(rest == "" or rest != rest for rest in tail), what
    for ours, theirs in zip(head, expected, strict=True):
        padded = isinstance(ours, float) and isinstance(theirs, int)  # rows of several lengths are floats
        same = ours == (float(theirs) if padded else theirs) or (ours != ours and theirs != theirs)
        assert same, (what, ours, theirs)
