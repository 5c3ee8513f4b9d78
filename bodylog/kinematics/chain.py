"""Forward kinematics between two links, with derivatives, vectorised over rows of joint angles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ModelError
from ..types import Array
from .robot import MOVING, Joint, Robot
from .rotations import invert_transform, make_transform, rotation_from_z


@dataclass(frozen=True, eq=False)
class Chain:
    """Steps from a start link to an end link; step k turns about, or slides along, its own z axis.

    joints (M,): names in the order of q · fixed (K+1,4,4): before each step
    and after the last, m · column (K,): each step's column in q · scale,
    zero (K,): its angle is scale · q + zero (rad, or m where `slides` (K,)).
    """

    start: str
    end: str
    joints: tuple[str, ...]
    fixed: Array
    column: Array
    scale: Array
    zero: Array
    slides: Array

    def at(self, q: Array) -> "ChainPoses":
        """Poses of the end link in the start link at q (N,M), rad or m."""
        angle = q[:, self.column] * self.scale + self.zero
        rotation = np.broadcast_to(self.fixed[0, :3, :3], (len(q), 3, 3))
        place = np.broadcast_to(self.fixed[0, :3, 3], (len(q), 3))
        axes, origins, strides = np.empty((3, len(q), len(self.column), 3))
        for k, slides in enumerate(self.slides):
            axes[:, k] = rotation[:, :, 2]
            origins[:, k] = place
            if slides:
                place = place + rotation[:, :, 2] * angle[:, k, None]
            else:
                rotation = _turn_about_z(rotation, angle[:, k])
            # as one product of tall matrices, for those of many small ones take five times as long
            rows = rotation.reshape(-1, 3)
            strides[:, k] = (rows @ self.fixed[k + 1, :3, 3]).reshape(-1, 3)
            place = place + strides[:, k]
            rotation = (rows @ self.fixed[k + 1, :3, :3]).reshape(-1, 3, 3)
        return ChainPoses(rotation, place, axes, origins, strides[:, :-1])

    def slopes(self, poses: "ChainPoses", points: Array) -> Array:
        """Derivatives (N,C,3,M), m per rad or m, of
        points (N,C,3) in the start link by the joints.
        """
        result = np.zeros((*points.shape, len(self.joints)))
        for k, slides in enumerate(self.slides):
            axis = poses.axes[:, None, k]
            lean = axis if slides else cross_products(axis, points - poses.origins[:, None, k])
            result[..., self.column[k]] += self.scale[k] * lean
        return result

    def holding(self, still: Mapping[str, float]) -> "Chain":
        """Return the chain with the named joints fixed at
        their angles (rad or m) and removed from its joints.
        """
        kept = [m for m, name in enumerate(self.joints) if name not in still]
        fixed = [self.fixed[0]]
        steps = []
        for k, column in enumerate(self.column):
            name = self.joints[column]
            if name in still:
                angle = float(self.scale[k] * still[name] + self.zero[k])
                fixed[-1] = (
                    fixed[-1] @ _step_transform(angle, bool(self.slides[k])) @ self.fixed[k + 1]
                )
            else:
                steps.append(k)
                fixed.append(self.fixed[k + 1])
        place = {old: new for new, old in enumerate(kept)}
        columns = np.array([place[int(self.column[k])] for k in steps], np.int64)
        joints = tuple(self.joints[m] for m in kept)
        picked = (part[steps] for part in (self.scale, self.zero, self.slides))
        return Chain(self.start, self.end, joints, np.array(fixed), columns, *picked)

    def over(self, joints: Sequence[str]) -> "Chain":
        """Return the chain for q with columns `joints`, which include all of the chain's."""
        column = np.array([joints.index(self.joints[c]) for c in self.column], np.int64)
        return replace(self, joints=tuple(joints), column=column)


@dataclass(frozen=True, eq=False)
class ChainPoses:
    """rotation (N,3,3) and place (N,3) m of the end link in
    the start link · axes, origins (N,K,3) of the steps there.

    strides (N,K−1,3) m: from each step to the next, there.
    """

    rotation: Array
    place: Array
    axes: Array
    origins: Array
    strides: Array


def chain_between(robot: Robot, start: str, end: str) -> Chain:
    """Return the chain between two links; its joints are
    those with an encoder of their own, from start to end.

    ModelError for an unknown link, or for a joint on the path of an unsupported kind.
    """
    for link in (start, end):
        if link not in robot.links:
            raise ModelError(
                f"{robot.source}: no link {link!r}; possible: {', '.join(robot.links[:30])}"
            )
    down = _joints_above(robot, end)
    up = _joints_above(robot, start)
    shared = {joint.name for joint in down} & {joint.name for joint in up}
    ways = [(joint, -1) for joint in up if joint.name not in shared]
    ways += [(joint, 1) for joint in reversed(down) if joint.name not in shared]
    return _chain_joints(robot, start, end, ways)


def _joints_above(robot: Robot, link: str) -> list[Joint]:
    path = []
    while link in robot.above:
        path.append(robot.above[link])
        link = path[-1].parent
    return path


def _chain_joints(robot: Robot, start: str, end: str, ways: Sequence[tuple[Joint, int]]) -> Chain:
    fixed = [np.eye(4)]
    steps = list[tuple[int, float, float, bool]]()
    names: dict[str, int] = {}
    for joint, way in ways:
        before, after = (
            (joint.origin, np.eye(4)) if way > 0 else (np.eye(4), invert_transform(joint.origin))
        )
        if joint.kind in MOVING:
            tilt = make_transform(rotation_from_z(joint.axis), np.zeros(3))
            name, scale, zero = robot.driven[joint.name]
            column = names.setdefault(name, len(names))
            steps.append((column, way * scale, way * zero, joint.kind == "prismatic"))
            fixed[-1] = fixed[-1] @ before @ tilt
            fixed.append(tilt.T @ after)
        elif joint.kind == "fixed":
            fixed[-1] = fixed[-1] @ before @ after
        else:
            what = (
                f"joint {joint.name!r} between {start} and {end} is {joint.kind}, which is not "
                "supported"
            )
            raise ModelError(f"{robot.source}: {what}; possible: {', '.join(MOVING)}, fixed")
    columns = [np.array(part) for part in zip(*steps, strict=True)] or [np.empty(0)] * 4
    kinds = (np.int64, float, float, bool)
    return Chain(
        start,
        end,
        tuple(names),
        np.array(fixed),
        *(c.astype(k) for c, k in zip(columns, kinds, strict=True)),
    )


def cross_products(a: Array, b: Array) -> Array:
    """Cross products (…,3); np.cross takes five times as long on few rows."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k in range(3):
        i = (k + 1) % 3
        j = (k + 2) % 3
        result[..., k] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return result


def _turn_about_z(rotation: Array, angle: Array) -> Array:
    """rotation (N,3,3) · Rz(angle (N,))."""
    cos = np.cos(angle)[:, None]
    sin = np.sin(angle)[:, None]
    x = rotation[:, :, 0]
    y = rotation[:, :, 1]
    result = np.empty(rotation.shape)
    result[:, :, 0] = cos * x + sin * y
    result[:, :, 1] = cos * y - sin * x
    result[:, :, 2] = rotation[:, :, 2]
    return result


def _step_transform(angle: float, slides: bool) -> Array:
    if slides:
        return make_transform(np.eye(3), np.array([0.0, 0.0, angle]))
    cos = np.cos(angle)
    sin = np.sin(angle)
    return make_transform(
        np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3)
    )
