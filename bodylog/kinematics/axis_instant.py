"""What a chain of axes predicts at one posture in plain floats, five times faster than NumPy."""

from math import cos, sin

import numpy as np

from ..types import Array
from .axis_chain import AxisChain
from .instant import Instant, Row, project_point, scale_point


def compile_axes(chain: AxisChain) -> Instant:
    """A function from one posture to what `AxisChain.see` predicts there."""
    axes: list[Row] = [tuple(one) for one in chain.frames[:, 2].tolist()]
    pivots: list[Row] = [tuple(one) for one in chain.pivots.tolist()]
    sides: list[tuple[Row, Row]] = [
        (tuple(first), tuple(second)) for first, second in chain.frames[:, :2].tolist()
    ]
    order = chain.order.tolist()
    middle = chain.middle.tolist()
    place = chain.place.tolist()
    lens = chain.lens.tolist()
    known = chain.of_lens.start

    def at(x: Array) -> tuple[Array, Array, Array]:
        angles = x.tolist()
        turns = [(cos(a), sin(a)) for a in (angles[m] - middle[m] for m in order)]
        px, py, pz = place
        arms = list[tuple[Row, Row]]()
        for axis, (ox, oy, oz), (c, s) in zip(axes[::-1], pivots[::-1], turns[::-1], strict=True):
            still = px - ox, py - oy, pz - oz
            arm = _turn_about_axis(axis, c, s, still)
            arms.append((still, arm))
            px = arm[0] + ox
            py = arm[1] + oy
            pz = arm[2] + oz
        image, rows, by_lens = project_point(px, py, pz, lens) if lens else scale_point(px, py, pz)
        steps = list(zip(order, axes, sides, arms[::-1], turns, strict=True))
        slopes = [[0.0] * len(angles) for _ in rows]
        design = []
        for slope, row, own in zip(slopes, rows, by_lens, strict=True):
            by_axes = list[float]()
            for m, axis, ((a, b, d), (e, f, g)), (still, arm), (c, s) in steps:
                before = _turn_about_axis(axis, c, -s, row)
                # the turned cross product is that of the turned arm and row
                sx, sy, sz = _cross_product(arm, row)
                slope[m] = axis[0] * sx + axis[1] * sy + axis[2] * sz
                bx, by, bz = _cross_product(still, before)
                sx -= bx
                sy -= by
                sz -= bz
                tx = row[0] - before[0]
                ty = row[1] - before[1]
                tz = row[2] - before[2]
                by_axes += (
                    e * sx + f * sy + g * sz,
                    -(a * sx + b * sy + d * sz),
                    a * tx + b * ty + d * tz,
                    e * tx + f * ty + g * tz,
                )
                row = before
            design.append((*row[:known], *own, *by_axes))
        return np.array(image), np.array(slopes), np.array(design)

    return at


def _turn_about_axis(axis: Row, c: float, s: float, v: Row) -> Row:
    """A vector turned about an axis by an angle of this cosine and sine (Rodrigues)."""
    a, b, d = axis
    x, y, z = v
    along = (1.0 - c) * (a * x + b * y + d * z)
    return (
        c * x + s * (b * z - d * y) + along * a,
        c * y + s * (d * x - a * z) + along * b,
        c * z + s * (a * y - b * x) + along * d,
    )


def _cross_product(v: Row, w: Row) -> Row:
    return v[1] * w[2] - v[2] * w[1], v[2] * w[0] - v[0] * w[2], v[0] * w[1] - v[1] * w[0]
