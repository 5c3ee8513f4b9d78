"""What one sight of a rig shows at one posture, in plain numbers: NumPy's calls would take twenty times as long."""

from collections.abc import Callable, Sequence
from math import cos, exp, sin

import numpy as np

from ..types import Array
from .camera import NEAREST
from .rig import Rig
from .rotations import left_jacobian, skew

Row = tuple[float, float, float]
Lens = tuple[float, float, float, float, float, float]
Instant = Callable[[Array], tuple[Array, Array, Array]]
"""From joint angles (M,) rad or m: image (2,) px · slope (2,M) by the joints · design (2,P) by θ, as of `Rig.see`."""


def instant(rig: Rig, theta: Array) -> Instant:
    """A function from one posture to what the rig's first sight shows of its point, for unknowns theta (P,)."""
    sight = rig.sights[0]
    own, mine = theta[rig.of_camera(0)], theta[rig.of_carrier(0)]
    first = rig.camera_pose(0, theta) @ sight.chain.fixed[0]
    fixed = [_plain(first), *(_plain(one) for one in sight.chain.fixed[1:])]
    place = rig.carrier_pose(0, theta)
    placed = place[:3, :3] @ sight.points[0] + place[:3, 3]
    zeros = sight.chain.zero + sight.chain.scale * theta[rig.of_joints][sight.chain.column]
    each = (sight.chain.column, sight.chain.scale, zeros, sight.chain.slides)
    scaled, gain = len(rig.scale_doubt) > 0, rig.gain(theta)
    steps = list(zip(*(part.tolist() for part in each), strict=True))
    by_turn, turn = placed - mine[:3], tuple(left_jacobian(own[3:6]).T.reshape(-1).tolist())
    marker = (-skew(by_turn) @ left_jacobian(mine[3:])).T.reshape(-1).tolist() if len(mine) == 6 else None
    lens, shift, joints = own[6:].tolist(), own[:3].tolist(), len(rig.joints)
    joint_part, none, last, end_point = rig.of_joints, [0.0] * joints, fixed[-1], placed.tolist()
    way = tuple(range(len(steps) - 1, -1, -1))

    def at(x: Array) -> tuple[Array, Array, Array]:
        angles = (gain * x if scaled else x).tolist()
        turned = [(0.0, 0.0, 0.0, 0.0)] * len(steps)
        px, py, pz = _applied(last, end_point)
        for k in way:
            column, scale, zero, slides = steps[k]
            angle = scale * angles[column] + zero
            if slides:
                c, s, pz = 1.0, 0.0, pz + angle
            else:
                c, s = cos(angle), sin(angle)
                px, py = c * px - s * py, s * px + c * py
            turned[k] = (c, s, px, py)
            px, py, pz = _applied(fixed[k], (px, py, pz))
        image, rows, by_lens = _projected(px, py, pz, lens)
        ix, iy, iz = px - shift[0], py - shift[1], pz - shift[2]
        design = []
        for row, by in zip(rows, by_lens, strict=True):
            slope, g = none.copy(), _before(fixed[0], row)
            for (column, scale, _, slides), (c, s, x_, y_), after in zip(steps, turned, fixed[1:], strict=True):
                slope[column] += scale * (g[2] if slides else g[1] * x_ - g[0] * y_)
                g = _before(after, (c * g[0] + s * g[1], c * g[1] - s * g[0], g[2]))
            a, b, e = row
            by_turning = _weighed(turn, iy * e - iz * b, iz * a - ix * e, ix * b - iy * a)
            more = () if marker is None else _weighed(marker, *g)
            design.append((*row, *by_turning, *by, *g, *more, *slope))
        result = np.array(design)
        if scaled:
            by_angle = result[:, joint_part]
            return np.array(image), by_angle * gain, np.concatenate([result, by_angle * x], axis=1)
        return np.array(image), result[:, joint_part], result

    return at


def _plain(pose: Array) -> tuple[float, ...]:
    """The twelve numbers of a pose, row by row."""
    return tuple(pose[:3].reshape(-1).tolist())


def _applied(pose: tuple[float, ...], p: "Row | list[float]") -> Row:
    a, b, c, d, e, f, g, h, i, j, k, m = pose
    x, y, z = p
    return a * x + b * y + c * z + d, e * x + f * y + g * z + h, i * x + j * y + k * z + m


def _weighed(m: Sequence[float], x: float, y: float, z: float) -> Row:
    """A row (3,) times a matrix, whose nine numbers are given column by column."""
    return m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z


def _before(pose: tuple[float, ...], g: Row) -> Row:
    """A slope by a point, as one by the point before it was turned."""
    a, b, c, _, e, f, h, _, i, j, k, _ = pose
    x, y, z = g
    return a * x + e * y + i * z, b * x + f * y + j * z, c * x + h * y + k * z


def _projected(
    px: float, py: float, pz: float, lens: list[float]
) -> tuple[tuple[float, float], tuple[Row, Row], tuple[Lens, Lens]]:
    """`camera.project` of one point."""
    depth, far = max(pz, NEAREST), pz > NEAREST
    x, y = px / depth, py / depth
    fu = exp(lens[0])
    fv = fu * exp(lens[1])
    square = x * x + y * y
    bend = 1.0 + square * (lens[4] + lens[5] * square)
    rise = 2.0 * (lens[4] + 2.0 * lens[5] * square)
    xx, xy, yy = bend + rise * x * x, rise * x * y, bend + rise * y * y
    one = 1.0 / depth
    rows = (
        (fu * xx * one, fu * xy * one, -fu * (xx * x + xy * y) * one if far else 0.0),
        (fv * xy * one, fv * yy * one, -fv * (xy * x + yy * y) * one if far else 0.0),
    )
    u, v = fu * x * bend, fv * y * bend
    ku, kv = fu * x * square, fv * y * square
    by_lens = (u, 0.0, 1.0, 0.0, ku, ku * square), (v, v, 0.0, 1.0, kv, kv * square)
    return (u + lens[2], v + lens[3]), rows, by_lens
