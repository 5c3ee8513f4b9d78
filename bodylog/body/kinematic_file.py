"""A KinematicGP as plain arrays and names, and back; what contradicts itself is refused by field."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..kinematics.chain import Chain
from ..kinematics.rig import Camera, Carrier, Rig, Sight
from ..types import Array
from .gp import GP
from .kinematic_gp import KinematicGP

# k steps and one, h steps, p unknowns, q directions of them, c points; digits are sizes
SHAPES = {
    "chain": "k44",
    "steps": "h4",
    "camera": "44",
    "marker": "44",
    "lens": "6",
    "doubt": "p",
    "theta": "p",
    "root": "pq",
    "lean": "dqn",
    "drift": "d",
    "points": "c3",
    "point": "1",
}
_NAMES = ("camera", "camera_link", "marker", "marker_link", "sight", "start", "end")


def arrays(model: KinematicGP) -> dict[str, Array]:
    """What SHAPES names, of a model with one camera, marker and sight."""
    rig, sight = model.rig, model.rig.sights[0]
    chain = sight.chain
    return {
        "chain": chain.fixed,
        "steps": np.column_stack([chain.column, chain.scale, chain.zero, chain.slides]),
        "camera": rig.cameras[0].anchor,
        "marker": rig.carriers[0].anchor,
        "lens": rig.cameras[0].lens,
        "doubt": rig.prior[1],
        "theta": model.theta,
        "root": model.root,
        "lean": model.lean,
        "drift": model.drift,
        "points": sight.points,
        "point": np.array([model.point]),
    }


def names(model: KinematicGP) -> dict[str, str]:
    """The names in it."""
    rig, sight = model.rig, model.rig.sights[0]
    camera, marker = rig.cameras[0], rig.carriers[0]
    values = (camera.name, camera.link, marker.name, marker.link, sight.name, sight.chain.start, sight.chain.end)
    return dict(zip(_NAMES, values, strict=True))


def build(plain: GP, joints: tuple[str, ...], found: Mapping[str, Array], said: Mapping[str, Any]) -> KinematicGP:
    """The model of a residual, arrays as SHAPES and names; ValueError for what contradicts itself."""
    steps, doubt, count = found["steps"], found["doubt"], len(joints)
    turns = len(doubt) == 18 + count
    _insist(len(found["chain"]) == len(steps) + 1, "steps", len(steps), f"{len(found['chain']) - 1} steps")
    _insist(turns or len(doubt) == 15 + count, "doubt", len(doubt), f"{15 + count} or {18 + count} numbers")
    _insist((doubt > 0).all(), "doubt", float(doubt.min()), "positive numbers")
    column, slides = steps[:, 0].astype(np.int64), steps[:, 3]
    _insist((column == steps[:, 0]).all() and (column >= 0).all() and (column < count).all(), "steps", column, "joints")
    _insist(np.isin(slides, (0.0, 1.0)).all(), "steps", slides, "0 or 1 in the last column")
    point = int(found["point"][0])
    _insist(found["point"][0] == point and 0 <= point < len(found["points"]), "point", point, "one of points")
    chain = Chain(said["start"], said["end"], joints, found["chain"], column, steps[:, 1], steps[:, 2], slides > 0)
    end = 18 if turns else 15
    rig = Rig(
        (Camera(said["camera"], said["camera_link"], found["camera"], found["lens"], doubt[:12]),),
        (Carrier(said["marker"], said["marker_link"], found["marker"], doubt[12:end]),),
        (Sight(said["sight"], 0, 0, chain, found["points"]),),
        joints,
        doubt[end:],
    )
    return KinematicGP.on(plain, rig, found["theta"], found["root"], found["lean"], found["drift"], point)


def checked(said: Any) -> dict[str, str]:
    """The names of a header; ValueError where one is missing."""
    if not isinstance(said, dict) or not all(isinstance(said.get(name), str) for name in _NAMES):
        raise ValueError(f"kinematics: found {str(said)[:80]}, possible: texts for {', '.join(_NAMES)}")
    return {name: said[name] for name in _NAMES}


def _insist(sound: Any, field: str, found: object, possible: str) -> None:
    if not sound:
        raise ValueError(f"{field}: found {found}, possible: {possible}")
