"""A URDF with its joints' zeros moved: what a controller that adds no offsets needs."""

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from ..errors import ModelError
from ..types import Array
from .rotations import exponential, to_rpy, transform
from .urdf import Joint, Robot, element, parse


def corrected(text: str, source: str, zeros: Mapping[str, float]) -> str:
    """The URDF whose joints at q are where `text` has them at q + zero (rad or m), followers of those joints as well.

    ModelError for a joint that is not in it.
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
    """How far a joint, or the one it follows, is off, in its own rad or m."""
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
