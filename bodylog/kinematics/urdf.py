"""A URDF as records: links, joints, how they hang together; what cannot be read is refused by name."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError
from ..io.atomic_files import text as read_text
from ..types import Array
from .rotations import from_rpy, transform

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MOVING = ("revolute", "continuous", "prismatic")
KINDS = (*MOVING, "fixed", "floating", "planar")
_MOST_BYTES = 1 << 25
_MOST_JOINTS = 10_000
_DEEPEST = 100


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: its angle is multiplier · that of `joint` + offset (rad or m)."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Limits:
    """Where a joint can be, rad or m by `unit`; `rounding`: half a unit of the last digit that the URDF gives."""

    lower: float
    upper: float
    rounding: float
    unit: str


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint: origin (4,4) of the child in the parent at zero, m · axis (3,), of length one, in the child.

    limits: None where it has none, or none that make sense.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Array
    axis: Array
    mimic: Mimic | None = None
    limits: Limits | None = None


@dataclass(frozen=True, eq=False)
class Robot:
    """A tree of links; `source` is where it was read, for messages."""

    name: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    source: str

    @cached_property
    def above(self) -> Mapping[str, Joint]:
        """The joint above each link but the root."""
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def by_name(self) -> Mapping[str, Joint]:
        """Joints by name."""
        return {joint.name: joint for joint in self.joints}

    @cached_property
    def root(self) -> str:
        """The link that no joint leads to."""
        return next(link for link in self.links if link not in self.above)


def load(path: Path) -> Robot:
    """Read a URDF file; FormatError says what is wrong with it."""
    return parse(text(path), str(path))


def text(path: Path) -> str:
    """A URDF's text; FormatError where it cannot be read."""
    try:
        return read_text(path, _MOST_BYTES)
    except (OSError, UnicodeDecodeError) as problem:
        raise FormatError(f"{path}: cannot be read as a URDF ({problem})") from problem


def parse(said: str, source: str) -> Robot:
    """A URDF's text as a Robot; FormatError, beginning with `source`, says what is wrong with it."""
    root = element(said, source)
    if root.tag != "robot":
        raise FormatError(f"{source}: the XML begins with <{root.tag[:40]}>; a URDF begins with <robot>")
    if any("xacro" in str(child.tag) for child in root):
        raise FormatError(f"{source}: holds xacro commands; type: xacro {source} > robot.urdf")
    links = tuple(_name(link, "link", source) for link in root.findall("link"))
    elements = [one for one in root.findall("joint") if "type" in one.attrib or one.find("parent") is not None]
    if len(elements) > _MOST_JOINTS:
        raise FormatError(f"{source}: {len(elements)} joints; possible: at most {_MOST_JOINTS}")
    robot = Robot(root.get("name", ""), links, tuple(_joint(one, source) for one in elements), source)
    for problem in _problems(robot):
        raise FormatError(f"{source}: {problem}")
    return robot


def element(said: str, source: str) -> "Element":
    """The XML's root; entities, which may grow without bound or read files, are refused with their declaration."""
    from xml.etree.ElementTree import TreeBuilder
    from xml.parsers import expat

    def refuse(*_: object) -> None:
        raise FormatError(f"{source}: holds a <!DOCTYPE>, which no URDF needs; remove it")

    def begin(tag: str, attributes: dict[str, str]) -> None:
        open_.append(tag)
        if len(open_) > _DEEPEST:
            raise FormatError(f"{source}: elements stand {_DEEPEST} deep in one another; give a URDF file")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        open_.pop()
        builder.end(tag)

    builder, parser, open_ = TreeBuilder(), expat.ParserCreate("utf-8"), list[str]()
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(said.encode("utf-8", "replace"), True)
    except expat.ExpatError as problem:
        raise FormatError(f"{source}: not XML ({problem}); give a URDF file") from problem
    return builder.close()


def _joint(element: "Element", source: str) -> Joint:
    name = _name(element, "joint", source)
    where, kind = f"{source}: joint {name!r}", element.get("type", "")
    if kind not in KINDS:
        raise FormatError(f"{where}: type is {kind!r}; possible: {', '.join(KINDS)}")
    parent, child = (_attribute(element, end, "link", where) for end in ("parent", "child"))
    origin = element.find("origin")
    xyz, rpy = (np.zeros(3) if origin is None else _numbers(origin, key, "0 0 0", where) for key in ("xyz", "rpy"))
    axis = _axis(element, kind, where)
    pose, limits = transform(from_rpy(rpy), xyz), _limits(element, kind)
    return Joint(name, kind, parent, child, pose, axis, _mimic(element, where), limits)


def _axis(element: "Element", kind: str, where: str) -> Array:
    axis = element.find("axis")
    if axis is None or kind not in MOVING:
        return np.array([1.0, 0.0, 0.0])
    found = _numbers(axis, "xyz", "1 0 0", where)
    length = float(np.linalg.norm(found))
    if not 1e-9 < length < 1e9:
        raise FormatError(f"{where}: axis is {axis.get('xyz')!r}, of length zero; possible: a direction as 0 0 1")
    return found / length


def _mimic(element: "Element", where: str) -> Mimic | None:
    found = element.find("mimic")
    if found is None:
        return None
    factor, offset = (_numbers(found, key, default, where, 1)[0] for key, default in _FOLLOWS.items())
    return Mimic(found.get("joint", ""), float(factor), float(offset))


def _limits(element: "Element", kind: str) -> Limits | None:
    """A joint's limits; a URDF whose limits are no numbers, or leave no room, is good for all else."""
    found = element.find("limit")
    if found is None or kind not in LIMITED:
        return None
    texts = [found.get(key, "0") for key in ("lower", "upper")]
    try:
        lower, upper = map(float, texts)
    except ValueError:
        return None
    if not -1e9 < lower < upper < 1e9:
        return None
    digits = min(max(len(text.partition(".")[2]), 1) for text in texts if float(text))
    return Limits(lower, upper, 0.5 * 10.0**-digits, LIMITED[kind])


LIMITED = {"revolute": "rad", "prismatic": "m"}
"""Kinds of joints that have limits, and their unit."""
_FOLLOWS = {"multiplier": "1", "offset": "0"}


def _numbers(element: "Element", key: str, default: str, where: str, count: int = 3) -> Array:
    text = element.get(key, default)
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (count,) or not (np.abs(values) < 1e9).all():
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise FormatError(f"{where}: <{element.tag}> {key} is {text[:80]!r}; possible: {wanted}")
    return values


def _name(element: "Element", kind: str, source: str) -> str:
    name = element.get("name", "")
    if not name:
        raise FormatError(f"{source}: a <{kind}> has no name")
    return name


def _attribute(element: "Element", child: str, key: str, where: str) -> str:
    found = element.find(child)
    value = "" if found is None else found.get(key, "")
    if not value:
        raise FormatError(f"{where}: has no <{child} {key}=…>")
    return value


def _problems(robot: Robot) -> Iterator[str]:
    """What keeps the links and joints from being one tree."""
    links = set(robot.links)
    if not links:
        yield "has no <link>"
    for kind, names in (("link", list(robot.links)), ("joint", [joint.name for joint in robot.joints])):
        twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
        if twice is not None:
            yield f"{kind} {twice!r} is declared twice"
    for joint in robot.joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                yield f"joint {joint.name!r} leads to link {end!r}, which is not declared"
    yield from _loops(robot)
    yield from _followers(robot)


def _loops(robot: Robot) -> Iterator[str]:
    parents: dict[str, str] = {}
    for joint in robot.joints:
        if joint.child in parents:
            first = parents[joint.child]
            yield f"link {joint.child!r} hangs on two joints, {first!r} and {joint.name!r}; loops cannot be read"
        parents[joint.child] = joint.name
    sound: set[str] = set()
    for link in robot.links:
        path: list[str] = []
        while link in robot.above and link not in sound:
            path.append(link)
            link = robot.above[link].parent
            if link in path:
                yield f"links {', '.join(path[path.index(link) :][:5])} hang on one another in a loop"
                return
        sound.update(path)
    roots = [link for link in robot.links if link not in robot.above]
    if len(roots) > 1:
        yield f"links {', '.join(roots[:5])} hang on no joint; possible: one such link, the base"


def _followers(robot: Robot) -> Iterator[str]:
    for joint in robot.joints:
        seen = [joint.name]
        while joint.mimic is not None:
            if joint.mimic.joint not in robot.by_name:
                yield f"joint {joint.name!r} mimics {joint.mimic.joint!r}, which is not declared"
                return
            joint = robot.by_name[joint.mimic.joint]
            if joint.name in seen:
                yield f"joint {joint.name!r} mimics itself"
                return
            seen.append(joint.name)


def implausible(robot: Robot) -> str | None:
    """What no robot that works before a camera is like, if this one is: without lengths, or kilometres of them."""
    lengths = [float(np.linalg.norm(joint.origin[:3, 3])) for joint in robot.joints]
    if max(lengths, default=0.0) < _SHORTEST:
        return "none of its joints has an <origin> of any length"
    if max(lengths) > _LONGEST:
        joint = robot.joints[int(np.argmax(lengths))]
        return f"joint {joint.name!r} stands {max(lengths):.0f} m from the one before; are its lengths in mm?"
    return None


_SHORTEST, _LONGEST = 1e-4, 20.0
"""m: of the longest step from joint to joint."""
