"""Write calibrated joint zeros into a URDF, for controllers that add no offsets."""

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from ..errors import ModelError
from ..types import Array
from .robot import Joint, Robot
from .rotations import exponential, to_rpy, transform
from .urdf import element, parse


def corrected(text: str, source: str, zeros: Mapping[str, float]) -> str:
    """Return the URDF whose joints at q are where those of `text` are at q + zero (rad or m), mimic joints included.

    ModelError for an unknown joint.
    """
    robot = parse(text, source)
    missing = [name for name in zeros if name not in robot.by_name]
    if missing:
        raise ModelError(f"{source}: no joint {missing[0]!r}; possible: {', '.join(list(robot.by_name)[:30])}")
    root = element(text, source)
    for one in root.findall("joint"):
        joint = robot.by_name.get(one.get("name", ""))
        if joint is not None and (zero := _zero(robot, joint, zeros)):
            _place(one, joint.origin @ _moved(joint, zero))
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


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


def _place(joint: ElementTree.Element, pose: Array) -> None:
    """Write a joint's <origin>."""
    found = joint.find("origin")
    origin = ElementTree.SubElement(joint, "origin") if found is None else found
    origin.set("xyz", " ".join(repr(float(v)) for v in pose[:3, 3]))
    origin.set("rpy", " ".join(repr(float(v)) for v in to_rpy(pose[:3, :3])))
