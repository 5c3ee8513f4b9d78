"""A rig's prediction at one posture in plain floats,
twenty times faster than NumPy for single points.
"""

from collections.abc import Callable, Sequence
from math import cos, exp, sin
from typing import NamedTuple

import numpy as np

from ..types import MM_PER_M, Array
from .camera import NEAREST
from .rig import Rig
from .rotations import cross_product_matrix, left_jacobian

Row = tuple[float, float, float]
Turn = tuple[float, float, float, float]
Lens = tuple[float, ...]
"""Derivatives by the six numbers of a lens; none of a tracker, which has no lens."""
Projection = tuple[tuple[float, ...], tuple[Row, ...], tuple[Lens, ...]]
"""A point's image, and the derivatives of each of its numbers by the point and by the lens."""
Instant = Callable[[Array], tuple[Array, Array, Array]]
"""From joint angles (M,) rad or m: image (2,) px or point (3,) mm ·
slope (2,M) by the joints · design (2,P) by θ, as of `Rig.see`.
"""


class _Constants(NamedTuple):
    """A rig at fixed θ: poses between steps · (column, scale, zero, slides) of each step · the
    point on the last link · left Jacobians of the camera's and the marker's rotation · the camera's
    shift · lens · number of joints.
    """

    fixed: list[tuple[float, ...]]
    steps: list[tuple[int, float, float, bool]]
    point: list[float]
    turn: tuple[float, ...]
    marker: tuple[float, ...] | None
    shift: list[float]
    lens: list[float]
    joints: int


def compile_predictor(rig: Rig, theta: Array) -> Instant:
    """Return a function from one posture to the image point
    of the rig's first sight, for unknowns theta (P,).
    """
    known = _collect_constants(rig, theta)
    gain = rig.gain(theta)
    joints = rig.of_joints
    scaled = len(rig.scale_doubt) > 0

    def at(x: Array) -> tuple[Array, Array, Array]:
        (px, py, pz), turned = _forward_kinematics(known, (gain * x if scaled else x).tolist())
        image, rows, by_lens = (
            project_point(px, py, pz, known.lens) if known.lens else scale_point(px, py, pz)
        )
        arm = px - known.shift[0], py - known.shift[1], pz - known.shift[2]
        design = np.array(
            [_design_row(known, arm, turned, *both) for both in zip(rows, by_lens, strict=True)]
        )
        if scaled:
            by_angle = design[:, joints]
            return np.array(image), by_angle * gain, np.concatenate([design, by_angle * x], axis=1)
        return np.array(image), design[:, joints], design

    return at


def _collect_constants(rig: Rig, theta: Array) -> _Constants:
    """What does not change with the posture."""
    sight = rig.sights[0]
    own = theta[rig.of_camera(0)]
    mine = theta[rig.of_carrier(0)]
    first = rig.camera_pose(0, theta) @ sight.chain.fixed[0]
    fixed = [_pose_numbers(first), *(_pose_numbers(one) for one in sight.chain.fixed[1:])]
    place = rig.carrier_pose(0, theta)
    placed = place[:3, :3] @ sight.points[0] + place[:3, 3]
    zeros = sight.chain.zero + sight.chain.scale * theta[rig.of_joints][sight.chain.column]
    each = (sight.chain.column, sight.chain.scale, zeros, sight.chain.slides)
    steps = list(zip(*(part.tolist() for part in each), strict=True))
    by_turn = placed - mine[:3]
    turn = tuple(left_jacobian(own[3:6]).T.reshape(-1).tolist())
    marker = (
        tuple((-cross_product_matrix(by_turn) @ left_jacobian(mine[3:])).T.reshape(-1).tolist())
        if len(mine) == 6
        else None
    )
    return _Constants(
        fixed,
        steps,
        placed.tolist(),
        turn,
        marker,
        own[:3].tolist(),
        own[6:].tolist(),
        len(rig.joints),
    )


def _forward_kinematics(known: _Constants, angles: list[float]) -> tuple[Row, list[Turn]]:
    """The point in the camera, m, and cosine, sine
    and place (x, y) of it after each step's turn.
    """
    turned = [(1.0, 0.0, 0.0, 0.0)] * len(known.steps)
    px, py, pz = _apply_pose(known.fixed[-1], known.point)
    for k in range(len(known.steps) - 1, -1, -1):
        column, scale, zero, slides = known.steps[k]
        angle = scale * angles[column] + zero
        if slides:
            c = 1.0
            s = 0.0
            pz = pz + angle
        else:
            c = cos(angle)
            s = sin(angle)
            turned_x = c * px - s * py
            py = s * px + c * py
            px = turned_x
        turned[k] = (c, s, px, py)
        px, py, pz = _apply_pose(known.fixed[k], (px, py, pz))
    return (px, py, pz), turned


def _design_row(
    known: _Constants, arm: Row, turned: list[Turn], row: Row, by_lens: Lens
) -> tuple[float, ...]:
    """One row of the design (P,), for the derivative `row` of u or v by the point in the camera."""
    slope = [0.0] * known.joints
    g = _derivative_before_pose(known.fixed[0], row)
    for (column, scale, _, slides), (c, s, x, y), after in zip(
        known.steps, turned, known.fixed[1:], strict=True
    ):
        slope[column] += scale * (g[2] if slides else g[1] * x - g[0] * y)
        g = _derivative_before_pose(after, (c * g[0] + s * g[1], c * g[1] - s * g[0], g[2]))
    a, b, e = row
    ix, iy, iz = arm
    by_turn = _row_times_matrix(known.turn, iy * e - iz * b, iz * a - ix * e, ix * b - iy * a)
    by_marker = () if known.marker is None else _row_times_matrix(known.marker, *g)
    return (*row, *by_turn, *by_lens, *g, *by_marker, *slope)


def _pose_numbers(pose: Array) -> tuple[float, ...]:
    """The twelve numbers of a pose, row by row."""
    return tuple(pose[:3].reshape(-1).tolist())


def _apply_pose(pose: tuple[float, ...], p: "Row | list[float]") -> Row:
    a, b, c, d, e, f, g, h, i, j, k, m = pose
    x, y, z = p
    return a * x + b * y + c * z + d, e * x + f * y + g * z + h, i * x + j * y + k * z + m


def _row_times_matrix(m: Sequence[float], x: float, y: float, z: float) -> Row:
    """A row (3,) times a matrix of nine numbers, column by column."""
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[3] * x + m[4] * y + m[5] * z,
        m[6] * x + m[7] * y + m[8] * z,
    )


def _derivative_before_pose(pose: tuple[float, ...], g: Row) -> Row:
    """A derivative by a point, as one by the point before the pose was applied."""
    a, b, c, _, e, f, h, _, i, j, k, _ = pose
    x, y, z = g
    return a * x + e * y + i * z, b * x + f * y + j * z, c * x + h * y + k * z


def scale_point(px: float, py: float, pz: float) -> Projection:
    """`camera.scale_points` for one point."""
    mm = MM_PER_M
    rows = (mm, 0.0, 0.0), (0.0, mm, 0.0), (0.0, 0.0, mm)
    return (mm * px, mm * py, mm * pz), rows, ((), (), ())


def project_point(px: float, py: float, pz: float, lens: list[float]) -> Projection:
    """`camera.project_points` for one point."""
    depth = max(pz, NEAREST)
    far = pz > NEAREST
    x = px / depth
    y = py / depth
    fu = exp(lens[0])
    fv = fu * exp(lens[1])
    square = x * x + y * y
    bend = 1.0 + square * (lens[4] + lens[5] * square)
    rise = 2.0 * (lens[4] + 2.0 * lens[5] * square)
    xx = bend + rise * x * x
    xy = rise * x * y
    yy = bend + rise * y * y
    one = 1.0 / depth
    rows = (
        (fu * xx * one, fu * xy * one, -fu * (xx * x + xy * y) * one if far else 0.0),
        (fv * xy * one, fv * yy * one, -fv * (xy * x + yy * y) * one if far else 0.0),
    )
    u = fu * x * bend
    v = fv * y * bend
    ku = fu * x * square
    kv = fv * y * square
    by_lens = (u, 0.0, 1.0, 0.0, ku, ku * square), (v, v, 0.0, 1.0, kv, kv * square)
    return (u + lens[2], v + lens[3]), rows, by_lens
