"""Records of a robot's links and joints, and checks that they form a plausible tree."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..types import Array

MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: its angle is
    multiplier · that of `joint` + offset (rad or m).
    """

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Limits:
    """Range of a joint, rad or m by `unit`; `rounding`: half a unit of the URDF's last digit."""

    lower: float
    upper: float
    rounding: float
    unit: str


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint: origin (4,4) of the child in the parent at zero, m · unit axis (3,) in the child.

    limits: None where missing or invalid.
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
    """A tree of links; `source` names the file in messages.

    masses: kg and centre (3,) m of links that have them.
    """

    name: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    source: str
    masses: Mapping[str, tuple[float, Array]] = field(default_factory=dict)

    @cached_property
    def above(self) -> Mapping[str, Joint]:
        """The parent joint of each link except the root."""
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def by_name(self) -> Mapping[str, Joint]:
        """Joints by name."""
        return {joint.name: joint for joint in self.joints}

    @cached_property
    def driven(self) -> Mapping[str, tuple[str, float, float]]:
        """Of each joint the one that it follows, directly
        or by others: angle = scale · its angle + zero.
        """
        found: dict[str, tuple[str, float, float]] = {}
        for joint in self.joints:
            path = []
            while joint.mimic is not None and joint.name not in found:
                path.append(joint)
                joint = self.by_name[joint.mimic.joint]
            name, scale, zero = found.get(joint.name, (joint.name, 1.0, 0.0))
            found[joint.name] = name, scale, zero
            for follower in reversed(path):
                assert follower.mimic is not None
                zero = follower.mimic.multiplier * zero + follower.mimic.offset
                scale = follower.mimic.multiplier * scale
                found[follower.name] = name, scale, zero
        return found

    @cached_property
    def root(self) -> str:
        """The link without a parent joint."""
        return next(link for link in self.links if link not in self.above)

    def chain_order(self) -> list[str]:
        """Names of the joints from the root on, each
        branch to its end, as the URDF orders branches.
        """
        below: dict[str, list[Joint]] = {}
        for joint in self.joints:
            below.setdefault(joint.parent, []).append(joint)
        order = list[str]()
        waiting = list(reversed(below.get(self.root, [])))
        while waiting:
            joint = waiting.pop()
            order.append(joint.name)
            waiting += reversed(below.get(joint.child, []))
        return order


def find_tree_problems(robot: Robot) -> Iterator[str]:
    """Yield the reasons why links and joints are not one tree."""
    links = set(robot.links)
    if not links:
        yield "has no <link>"
    for kind, names in (
        ("link", robot.links),
        ("joint", tuple(joint.name for joint in robot.joints)),
    ):
        twice = next((name for name, count in Counter(names).items() if count > 1), None)
        if twice is not None:
            yield f"{kind} {twice!r} is declared twice"
    for joint in robot.joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                yield f"joint {joint.name!r} leads to link {end!r}, which is not declared"
    yield from _find_loops(robot)
    yield from _find_mimic_problems(robot)


def _find_loops(robot: Robot) -> Iterator[str]:
    parents: dict[str, str] = {}
    for joint in robot.joints:
        if joint.child in parents:
            first = parents[joint.child]
            yield (
                f"link {joint.child!r} hangs on two joints, {first!r} and {joint.name!r}; loops "
                "cannot be read"
            )
        parents[joint.child] = joint.name
    sound: set[str] = set()
    for link in robot.links:
        path: dict[str, None] = {}
        while link in robot.above and link not in sound:
            path[link] = None
            link = robot.above[link].parent
            if link in path:
                names = list(path)
                yield (
                    f"links {', '.join(names[names.index(link) :][:5])} hang on one another in a "
                    "loop"
                )
                return
        sound.update(path)
    roots = [link for link in robot.links if link not in robot.above]
    if len(roots) > 1:
        yield f"links {', '.join(roots[:5])} hang on no joint; possible: one such link, the base"


def _find_mimic_problems(robot: Robot) -> Iterator[str]:
    sound: set[str] = set()
    for joint in robot.joints:
        path = {joint.name}
        while joint.mimic is not None and joint.name not in sound:
            if joint.mimic.joint not in robot.by_name:
                yield f"joint {joint.name!r} mimics {joint.mimic.joint!r}, which is not declared"
                return
            joint = robot.by_name[joint.mimic.joint]
            if joint.name in path:
                yield f"joint {joint.name!r} mimics itself"
                return
            path.add(joint.name)
        sound |= path


def is_optical(link: str) -> bool:
    """Whether a link is a camera's optical frame by its
    name (REP 103): z forward, x to the right of the image.
    """
    return "optical" in link


def reason_implausible(robot: Robot) -> str | None:
    """Why a robot cannot be real, or None: all its joints coincide, or lie kilometres apart."""
    lengths = [float(np.linalg.norm(joint.origin[:3, 3])) for joint in robot.joints]
    slides = any(joint.kind == "prismatic" for joint in robot.joints)
    if max(lengths, default=0.0) < _SHORTEST and not slides:
        return "none of its joints has an <origin> of any length"
    if max(lengths, default=0.0) > _LONGEST:
        joint = robot.joints[int(np.argmax(lengths))]
        return (
            f"joint {joint.name!r} stands {max(lengths):.0f} m from the one before; are its "
            "lengths in mm?"
        )
    return None


_SHORTEST = 1e-4
_LONGEST = 20.0
"""m: bounds on the longest distance between consecutive joints."""
