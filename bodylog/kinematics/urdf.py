"""Parse a URDF into records of links and joints; errors name the element."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError
from ..io.atomic_files import read_limited_text as read_text
from ..logs.limits import LIMITS, Input
from ..types import Array
from .robot import MOVING, Joint, Limits, Mimic, Robot, find_tree_problems
from .rotations import make_transform, rotation_from_rpy

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

KINDS = (*MOVING, "fixed", "floating", "planar")
_MOST_BYTES = 1 << 25
_HEAVIEST_KG = 1e6
_DEEPEST = 100


def load_urdf(path: Path, limits: Input = LIMITS) -> Robot:
    """Read a URDF file; FormatError where it is invalid."""
    return parse_urdf(read_urdf_text(path), str(path), limits)


def read_urdf_text(path: Path) -> str:
    """Read a URDF's text; FormatError where it cannot be read."""
    try:
        return read_text(path, _MOST_BYTES)
    except (OSError, UnicodeDecodeError) as problem:
        raise FormatError(f"{path}: cannot be read as a URDF ({problem})") from problem


def parse_urdf(xml: str, source: str, limits: Input = LIMITS) -> Robot:
    """Parse a URDF's text; FormatError, beginning with
    `source`, where it is invalid or has too many joints.
    """
    root = parse_xml_root(xml, source)
    if root.tag != "robot":
        raise FormatError(
            f"{source}: the XML begins with <{root.tag[:40]}>; a URDF begins with <robot>"
        )
    if any("xacro" in str(child.tag) for child in root):
        raise FormatError(f"{source}: holds xacro commands; type: xacro {source} > robot.urdf")
    links = tuple(_require_name(link, "link", source) for link in root.findall("link"))
    elements = [
        one
        for one in root.findall("joint")
        if "type" in one.attrib or one.find("parent") is not None
    ]
    if len(elements) > limits.max_joints:
        asked = f"to read them, type in robot.toml: [input] max_joints = {len(elements)}"
        raise FormatError(
            f"{source}: {len(elements)} joints, at most {limits.max_joints} are read; {asked}"
        )
    masses = dict(_parse_masses(root, source))
    joints = tuple(_parse_joint(one, source) for one in elements)
    robot = Robot(root.get("name", ""), links, joints, source, masses)
    for problem in find_tree_problems(robot):
        raise FormatError(f"{source}: {problem}")
    return robot


def kinematic_text(xml: str) -> str:
    """A sound URDF's text with the names of its links
    and its joints alone, without shapes and masses.
    """
    from xml.etree.ElementTree import Element, tostring

    whole = parse_xml_root(xml, "URDF")
    kept = Element("robot", {"name": whole.get("name", "")})
    kept.extend(Element("link", {"name": link.get("name", "")}) for link in whole.findall("link"))
    kept.extend(
        one
        for one in whole.findall("joint")
        if "type" in one.attrib or one.find("parent") is not None
    )
    return tostring(kept, encoding="unicode")


def parse_xml_root(xml: str, source: str) -> "Element":
    """Parse XML to its root element; entities, which
    may grow without bound or read files, are refused.
    """
    from xml.etree.ElementTree import TreeBuilder
    from xml.parsers import expat

    def refuse(*_: object) -> None:
        raise FormatError(f"{source}: holds a <!DOCTYPE>, which no URDF needs; remove it")

    def begin(tag: str, attributes: dict[str, str]) -> None:
        open_.append(tag)
        if len(open_) > _DEEPEST:
            raise FormatError(
                f"{source}: elements stand {_DEEPEST} deep in one another; give a URDF file"
            )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        open_.pop()
        builder.end(tag)

    builder = TreeBuilder()
    parser = expat.ParserCreate("utf-8")
    open_ = list[str]()
    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(xml.encode("utf-8", "replace"), True)
    except expat.ExpatError as problem:
        raise FormatError(f"{source}: not XML ({problem}); give a URDF file") from problem
    return builder.close()


def _parse_masses(root: "Element", source: str) -> Iterator[tuple[str, tuple[float, Array]]]:
    """Yield links with their mass, kg, and its centre, m; those that state none are left out."""
    for link in root.findall("link"):
        inertial = link.find("inertial")
        mass = None if inertial is None else inertial.find("mass")
        if inertial is None or mass is None:
            continue
        where = f"{source}: link {link.get('name', '')!r}: inertial"
        origin = inertial.find("origin")
        centre = (
            np.zeros(3) if origin is None else _parse_number_list(origin, "xyz", "0 0 0", where)
        )
        try:
            value = float(mass.get("value", ""))
        except ValueError:
            value = float("nan")
        if not 0.0 <= value < _HEAVIEST_KG:
            found = mass.get("value", "")[:40]
            raise FormatError(f"{where}: mass is {found!r}; possible: 0 to {_HEAVIEST_KG:g} kg")
        yield link.get("name", ""), (value, centre)


def _parse_joint(element: "Element", source: str) -> Joint:
    name = _require_name(element, "joint", source)
    where = f"{source}: joint {name!r}"
    kind = element.get("type", "")
    if kind not in KINDS:
        raise FormatError(f"{where}: type is {kind!r}; possible: {', '.join(KINDS)}")
    parent, child = (_require_attribute(element, end, "link", where) for end in ("parent", "child"))
    origin = element.find("origin")
    xyz, rpy = (
        np.zeros(3) if origin is None else _parse_number_list(origin, key, "0 0 0", where)
        for key in ("xyz", "rpy")
    )
    axis = _parse_axis(element, kind, where)
    pose = make_transform(rotation_from_rpy(rpy), xyz)
    limits = _parse_limits(element, kind)
    return Joint(name, kind, parent, child, pose, axis, _parse_mimic(element, where), limits)


def _parse_axis(element: "Element", kind: str, where: str) -> Array:
    axis = element.find("axis")
    if axis is None or kind not in MOVING:
        return np.array([1.0, 0.0, 0.0])
    found = _parse_number_list(axis, "xyz", "1 0 0", where)
    length = float(np.linalg.norm(found))
    if not 1e-9 < length < 1e9:
        raise FormatError(
            f"{where}: axis is {axis.get('xyz')!r}, of length zero; possible: a direction as 0 0 1"
        )
    return found / length


def _parse_mimic(element: "Element", where: str) -> Mimic | None:
    found = element.find("mimic")
    if found is None:
        return None
    factor, offset = (
        _parse_number_list(found, key, default, where, 1)[0] for key, default in _FOLLOWS.items()
    )
    return Mimic(found.get("joint", ""), float(factor), float(offset))


def _parse_limits(element: "Element", kind: str) -> Limits | None:
    """A joint's limits; None where they are missing or invalid, which is no error."""
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


def _parse_number_list(
    element: "Element", key: str, default: str, where: str, count: int = 3
) -> Array:
    text = element.get(key, default)
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (count,) or not (np.abs(values) < 1e9).all():
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise FormatError(f"{where}: <{element.tag}> {key} is {text[:80]!r}; possible: {wanted}")
    return values


def _require_name(element: "Element", kind: str, source: str) -> str:
    name = element.get("name", "")
    if not name:
        raise FormatError(f"{source}: a <{kind}> has no name")
    return name


def _require_attribute(element: "Element", child: str, key: str, where: str) -> str:
    found = element.find(child)
    value = "" if found is None else found.get(key, "")
    if not value:
        raise FormatError(f"{where}: has no <{child} {key}=…>")
    return value
