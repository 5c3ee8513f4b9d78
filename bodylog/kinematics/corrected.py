"""Write calibrated joint zeros into a URDF, for controllers that add no offsets."""

import re
from collections.abc import Mapping
from xml.parsers import expat

import numpy as np

from ..errors import ModelError
from ..types import Array
from .robot import Joint, Robot
from .rotations import exponential, to_rpy, transform
from .urdf import parse

_TAG = re.compile(rb"""<(?:[^<>"']|"[^"]*"|'[^']*')*>""")


def corrected(text: str, source: str, zeros: Mapping[str, float]) -> str:
    """Return the URDF whose joints at q are where those of `text` are at q + zero (rad or m), mimic joints included.

    Only <origin> tags change. ModelError for an unknown joint.
    """
    robot = parse(text, source)
    missing = [name for name in zeros if name not in robot.by_name]
    if missing:
        raise ModelError(f"{source}: no joint {missing[0]!r}; possible: {', '.join(list(robot.by_name)[:30])}")
    raw, done, parts = text.encode("utf-8", "replace"), 0, list[bytes]()
    for name, begin, end in _origins(raw):
        if name in robot.by_name and (zero := _zero(robot, joint := robot.by_name[name], zeros)):
            filled = begin < end and raw[end - 2 : end] != b"/>"
            parts += [raw[done:begin], _origin(joint.origin @ _moved(joint, zero), filled)]
            done = end
    return b"".join([*parts, raw[done:]]).decode("utf-8")


def _origins(raw: bytes) -> list[tuple[str, int, int]]:
    """Each joint's name, and where its <origin> tag begins and ends, or both where it belongs."""
    parser, open_, found = expat.ParserCreate("utf-8"), list[str](), list[tuple[str, int, int]]()

    def begin(tag: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        behind = next(_TAG.finditer(raw, at)).end()
        if len(open_) == 1 and tag == "joint":
            found.append((attributes.get("name", ""), behind, behind))
        elif open_[1:] == ["joint"] and tag == "origin":
            found[-1] = (found[-1][0], at, behind)
        open_.append(tag)

    def end(_: str) -> None:
        open_.pop()

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.Parse(raw, True)
    return found


def _zero(robot: Robot, joint: Joint, zeros: Mapping[str, float]) -> float:
    """Zero of a joint, or of the one it follows, in its own rad or m."""
    scale = 1.0
    while joint.mimic is not None:
        scale, joint = scale * joint.mimic.multiplier, robot.by_name[joint.mimic.joint]
    return scale * zeros.get(joint.name, 0.0)


def _moved(joint: Joint, zero: float) -> Array:
    if joint.kind == "prismatic":
        return transform(np.eye(3), joint.axis * zero)
    return transform(exponential(joint.axis * zero), np.zeros(3))


def _origin(pose: Array, filled: bool) -> bytes:
    """An <origin> tag, which another one closes if it is `filled`."""
    xyz, rpy = (" ".join(repr(float(v)) for v in part) for part in (pose[:3, 3], to_rpy(pose[:3, :3])))
    return f'<origin xyz="{xyz}" rpy="{rpy}"{"" if filled else "/"}>'.encode()
