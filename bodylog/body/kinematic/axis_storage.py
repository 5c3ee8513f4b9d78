"""An AxisGP as plain arrays, and back; inconsistent fields are refused by name."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...kinematics.axis_chain import AxisChain
from ...types import Array
from ..gp.axis_gp import AxisGP
from ..gp.model import GP
from .storage import insist_sound

# m joints, p unknowns, q directions of them, d outputs, n centres
SHAPES = {
    "place": "3",
    "lens": "6",
    "frames": "m33",
    "pivots": "m3",
    "order": "m",
    "middle": "m",
    "root": "pq",
    "lean": "dqn",
    "drift": "d",
}
_OF_CHAIN = ("place", "lens", "frames", "pivots", "order", "middle")
_ROUNDING = 1e-6
"""How far rows of a frame may be from unit vectors at right angles."""


def axis_arrays(model: AxisGP) -> dict[str, Array]:
    """The arrays of `axis_shapes`."""
    fields = axis_shapes(model.outputs)
    return {name: getattr(model.chain if name in _OF_CHAIN else model, name) for name in fields}


def axis_shapes(outputs: Sequence[str]) -> dict[str, str]:
    """The arrays of a model with these outputs, and their shapes; a tracker has no lens."""
    return {name: shape for name, shape in SHAPES.items() if name != "lens" or len(outputs) == 2}


def build_axis_gp(plain: GP, found: Mapping[str, Array]) -> AxisGP:
    """Build a model from a residual process and arrays; ValueError for inconsistent fields."""
    frames = found["frames"]
    order = found["order"]
    away = np.abs(frames @ frames.transpose(0, 2, 1) - np.eye(3)).max()
    insist_sound(away <= _ROUNDING, "frames", "axes that are not at right angles", "rotations")
    joints = np.arange(len(order))
    insist_sound((np.sort(order) == joints).all(), "order", order, "each joint once")
    lens = found.get("lens", np.zeros(0))
    chain = AxisChain(
        found["place"], lens, frames, found["pivots"], order.astype(np.int64), found["middle"]
    )
    unknowns = chain.unknown_count
    insist_sound(len(found["root"]) == unknowns, "root", len(found["root"]), f"{unknowns} rows")
    rest = {name: found[name] for name in ("root", "lean", "drift")}
    return AxisGP.on(plain, chain=chain, **rest)
