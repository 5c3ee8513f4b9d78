"""Write calibrated joint zeros and camera poses
into a URDF, for controllers that add no offsets.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from ..errors import ModelError
from ..types import Array
from .robot import Joint, Robot, is_optical
from .rotations import make_transform, rotation_from_vector, rpy_from_rotation
from .urdf import parse_urdf

_TAG = re.compile(rb"""<(?:[^<>"']|"[^"]*"|'[^']*')*>""")


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """A camera's optical frame: its pose (4,4) in a link,
    m, and the name of the link that a URDF gets for it.
    """

    link: str
    name: str
    pose: Array


def correct_urdf(
    text: str, source: str, zeros: Mapping[str, float], cameras: Sequence[CameraFrame] = ()
) -> str:
    """Return the URDF whose joints at q are where those of
    `text` are at q + zero (rad or m), mimic joints included.

    A camera's link moves to its pose where a fixed joint holds it and nothing hangs on it; else the
    camera gets a link of its own, or moves the one of that name. All else in the file stays.
    ModelError for an unknown joint or link.
    """
    robot = parse_urdf(text, source)
    missing = [name for name in zeros if name not in robot.by_name]
    if missing:
        raise ModelError(
            f"{source}: no joint {missing[0]!r}; possible: {', '.join(list(robot.by_name)[:30])}"
        )
    origins = {}
    for joint in robot.joints:
        if zero := _zero_with_mimic(robot, joint, zeros):
            origins[joint.name] = joint.origin @ _zero_transform(joint, zero)
    added = []
    for camera in cameras:
        fixed = _holding_joint(robot, source, camera)
        if fixed is None:
            added.append(camera)
        elif fixed.child == camera.link:
            origins[fixed.name] = fixed.origin @ camera.pose
        else:
            origins[fixed.name] = camera.pose
    raw = text.encode("utf-8", "replace")
    done = 0
    parts = list[bytes]()
    joints, end_of_robot = _find_origin_tags(raw)
    for name, begin, end in joints:
        if name in origins:
            filled = begin < end and raw[end - 2 : end] != b"/>"
            parts += [raw[done:begin], _origin_tag(origins[name], filled)]
            done = end
    parts += [raw[done:end_of_robot], *map(_link_element, added)]
    return b"".join([*parts, raw[end_of_robot:]]).decode("utf-8")


def _holding_joint(robot: Robot, source: str, camera: CameraFrame) -> Joint | None:
    """The fixed joint whose origin is the camera's pose; None where a link must be added."""
    if camera.link not in robot.links:
        raise ModelError(
            f"{source}: no link {camera.link!r}; possible: {', '.join(robot.links[:30])}"
        )
    named = robot.above.get(camera.name)
    if named is not None:
        if named.kind == "fixed" and named.parent == camera.link:
            return named
        taken = f"link {camera.name!r} is there, but no fixed joint holds it on {camera.link!r}"
        raise ModelError(f"{source}: {taken}; rename it")
    own = robot.above.get(camera.link)
    ends = {joint.parent for joint in robot.joints}
    movable = own is not None and own.kind == "fixed" and camera.link not in ends
    return own if movable and is_optical(camera.link) else None


def _link_element(camera: CameraFrame) -> bytes:
    """A link for a camera's optical frame and the fixed joint that holds it."""
    name, joint, parent = (
        quoteattr(one) for one in (camera.name, f"{camera.name}_joint", camera.link)
    )
    origin = _origin_tag(camera.pose, filled=False).decode()
    inner = f"{origin}<parent link={parent}/><child link={name}/>"
    return f'  <link name={name}/>\n  <joint name={joint} type="fixed">{inner}</joint>\n'.encode()


def _find_origin_tags(raw: bytes) -> tuple[list[tuple[str, int, int]], int]:
    """Each joint's name, and where its <origin> tag begins
    and ends, or both where it belongs; where </robot> is.
    """
    parser = expat.ParserCreate("utf-8")
    open_ = list[str]()
    found = list[tuple[str, int, int]]()
    ends = [len(raw)]

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
        if not open_:
            ends[0] = parser.CurrentByteIndex

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.Parse(raw, True)
    return found, ends[0]


def _zero_with_mimic(robot: Robot, joint: Joint, zeros: Mapping[str, float]) -> float:
    """Zero of a joint, or of the one it follows, in its own rad or m."""
    scale = 1.0
    while joint.mimic is not None:
        scale = scale * joint.mimic.multiplier
        joint = robot.by_name[joint.mimic.joint]
    return scale * zeros.get(joint.name, 0.0)


def _zero_transform(joint: Joint, zero: float) -> Array:
    if joint.kind == "prismatic":
        return make_transform(np.eye(3), joint.axis * zero)
    return make_transform(rotation_from_vector(joint.axis * zero), np.zeros(3))


def _origin_tag(pose: Array, filled: bool) -> bytes:
    """An <origin> tag, which another one closes if it is `filled`."""
    xyz, rpy = (
        " ".join(repr(float(v)) for v in part)
        for part in (pose[:3, 3], rpy_from_rotation(pose[:3, :3]))
    )
    return f'<origin xyz="{xyz}" rpy="{rpy}"{"" if filled else "/"}>'.encode()
