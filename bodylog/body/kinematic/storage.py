"""A KinematicGP as plain arrays and names, and back; inconsistent fields are refused by name."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...kinematics.chain import Chain
from ...kinematics.pose import Base
from ...kinematics.rig import Carrier, Rig, RigCamera, Sight
from ...types import Array
from ..gp.model import GP
from .model import KinematicGP

# k steps and one, h steps, p unknowns, q directions of them; digits are sizes
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
    "printed": "p",
    "points": "13",
}
BASE = {"base": "x44", "base_steps": "y4", "base_tool": "44"}
"""Arrays of a model with a base: x steps and one, y steps."""
RESTING = {"resting": "k44"}
"""The array of a model in which joints that stood still have zeros."""
HAND = {"hand": "z44", "hand_steps": "w4", "still": "e"}
"""Arrays of a base with a chain to the hand: z steps and one, w steps, e joints that rest."""
_STILL = "still_joints"
_BASE_NAMES = ("base_start", "base_end", "base_tool", "base_thing")
_SCALED = "scales"
_RESTED = "resting"
_MARKS = {_SCALED: "unknown", _RESTED: "known"}
"""Present, with these values, where each joint's scale is one more unknown, and where joints
that stood still have zeros.
"""
_THINGS = ("marker", "camera")
_UNKNOWNS = ("theta", "root", "lean", "drift", "printed")
_NAMES = ("camera", "camera_link", "marker", "marker_link", "sight", "start", "end")


def kinematic_arrays(model: KinematicGP) -> dict[str, Array]:
    """The arrays of SHAPES, of a model with one camera, marker and sight."""
    rig = model.rig
    sight = model.rig.sights[0]
    chain = sight.chain
    base = model.base
    carried = (
        {}
        if base is None
        else {
            "base": base.chain.fixed,
            "base_steps": _chain_step_array(base.chain),
            "base_tool": base.tool,
        }
    )
    if base is not None and base.hand is not None:
        carried |= {
            "hand": base.hand.fixed,
            "hand_steps": _chain_step_array(base.hand),
            "still": base.still,
        }
    rested = {} if model.resting is None else {_RESTED: model.resting}
    lens = {} if rig.cameras[0].tracks_space else {"lens": rig.cameras[0].lens}
    return (
        carried
        | rested
        | lens
        | {
            "chain": chain.fixed,
            "steps": _chain_step_array(chain),
            "camera": rig.cameras[0].anchor,
            "marker": rig.carriers[0].anchor,
            "doubt": rig.prior[1],
            "theta": model.theta,
            "root": model.root,
            "lean": model.lean,
            "drift": model.drift,
            "printed": model.printed,
            "points": sight.points,
        }
    )


def kinematic_names(model: KinematicGP) -> dict[str, str]:
    """The names in a model."""
    rig = model.rig
    sight = model.rig.sights[0]
    camera = rig.cameras[0]
    marker = rig.carriers[0]
    values = (
        camera.name,
        camera.link,
        marker.name,
        marker.link,
        sight.name,
        sight.chain.start,
        sight.chain.end,
    )
    base = model.base
    carried = dict[str, str]()
    if base is not None:
        texts = (base.chain.start, base.chain.end, base.link, _THINGS[base.camera])
        carried = dict(zip(_BASE_NAMES, texts, strict=True))
        if base.hand is not None:
            carried[_STILL] = "\n".join(base.still_joints)
    there = {_SCALED: len(rig.scale_doubt) > 0, _RESTED: model.resting is not None}
    marks = {name: word for name, word in _MARKS.items() if there[name]}
    return dict(zip(_NAMES, values, strict=True)) | carried | marks


def _chain_step_array(chain: Chain) -> Array:
    return np.column_stack([chain.column, chain.scale, chain.zero, chain.slides])


def kinematic_shapes(header: Mapping[str, Any], outputs: Sequence[str]) -> dict[str, str]:
    """The arrays of a model with these names and outputs,
    and their shapes; a tracker of points in space has no lens.
    """
    rested = RESTING if _RESTED in header else {}
    shapes = SHAPES | (BASE if _BASE_NAMES[0] in header else {}) | rested
    shapes |= HAND if _STILL in header else {}
    return {field: shape for field, shape in shapes.items() if field != "lens" or len(outputs) == 2}


def build_kinematic_gp(
    plain: GP, joints: tuple[str, ...], found: Mapping[str, Array], header: Mapping[str, Any]
) -> KinematicGP:
    """Build a model from a residual process, arrays as
    SHAPES and names; ValueError for inconsistent fields.
    """
    steps = found["steps"]
    doubt = found["doubt"]
    count = len(joints)
    own = 2 * count if _SCALED in header else count
    for field in ("chain", "camera", "marker", *(RESTING if _RESTED in header else ())):
        insist_rigid(found[field], field)
    lens = found.get("lens", np.zeros(0))
    for field, most in (
        ("theta", _LARGEST),
        ("printed", _LARGEST),
        ("lens", _LARGEST),
        ("points", _FARTHEST),
    ):
        if field not in found:
            continue
        insist_sound(
            (np.abs(found[field]) <= most).all(),
            field,
            float(np.abs(found[field]).max()),
            f"at most {most:g}",
        )
    pose = 6 + len(lens)
    least = pose + 3 + own
    turns = len(doubt) == least + 3
    insist_sound(
        turns or len(doubt) == least, "doubt", len(doubt), f"{least} or {least + 3} numbers"
    )
    insist_sound((doubt > 0).all(), "doubt", float(doubt.min()), "positive numbers")
    chain = _build_chain(header["start"], header["end"], joints, found["chain"], steps, "steps")
    end = pose + (6 if turns else 3)
    seer = RigCamera(header["camera"], header["camera_link"], found["camera"], lens, doubt[:pose])
    rig = Rig(
        (seer,),
        (Carrier(header["marker"], header["marker_link"], found["marker"], doubt[pose:end]),),
        (Sight(header["sight"], 0, 0, chain, found["points"]),),
        joints,
        doubt[end : end + count],
        doubt[end + count :],
    )
    unknowns = {name: found[name] for name in _UNKNOWNS}
    model = KinematicGP.on(plain, rig=rig, **unknowns)
    rested = found[_RESTED] if _RESTED in header else None
    return replace(model, base=_build_base(joints, found, header), resting=rested)


def _build_chain(
    start: str, end: str, joints: tuple[str, ...], fixed: Array, steps: Array, field: str
) -> Chain:
    insist_sound(len(fixed) == len(steps) + 1, field, len(steps), f"{len(fixed) - 1} steps")
    count = len(joints)
    insist_sound(
        (np.abs(steps[:, 0]) <= count).all(),
        field,
        float(np.abs(steps[:, 0]).max(initial=0.0)),
        "joints",
    )
    column = steps[:, 0].astype(np.int64)
    slides = steps[:, 3]
    insist_sound(
        (column == steps[:, 0]).all() and (column >= 0).all() and (column < count).all(),
        field,
        column,
        "joints",
    )
    insist_sound(np.isin(slides, (0.0, 1.0)).all(), field, slides, "0 or 1 in the last column")
    moves = np.abs(steps[:, 1:3])
    insist_sound(
        (moves <= _LARGEST).all(), field, float(moves.max(initial=0.0)), f"at most {_LARGEST:g}"
    )
    return Chain(start, end, joints, fixed, column, steps[:, 1], steps[:, 2], slides > 0)


def _build_base(
    joints: tuple[str, ...], found: Mapping[str, Array], header: Mapping[str, Any]
) -> Base | None:
    if _BASE_NAMES[0] not in header:
        return None
    start, end, link, thing = (header[name] for name in _BASE_NAMES)
    for field in ("base", "base_tool"):
        insist_rigid(found[field], field)
    chain = _build_chain(start, end, joints, found["base"], found["base_steps"], "base_steps")
    base = Base(chain, found["base_tool"], link, thing == _THINGS[1])
    if _STILL not in header:
        return base
    insist_rigid(found["hand"], "hand")
    still = found["still"]
    further = tuple(header[_STILL].split("\n"))
    insist_sound(len(further) == len(still), "still", len(still), f"{len(further)} numbers")
    insist_sound((np.abs(still) <= _LARGEST).all(), "still", still, f"at most {_LARGEST:g}")
    every = (*joints, *further)
    hand = _build_chain(start, link, every, found["hand"], found["hand_steps"], "hand_steps")
    return replace(base, hand=hand, still=still)


def check_kinematic_names(header: Any) -> dict[str, str]:
    """The names of a header; ValueError where one is missing."""
    if not isinstance(header, dict) or not all(
        isinstance(header.get(name), str) for name in _NAMES
    ):
        raise ValueError(
            f"kinematics: found {str(header)[:80]}, possible: texts for {', '.join(_NAMES)}"
        )
    marks = {name: word for name, word in _MARKS.items() if name in header}
    for name, word in marks.items():
        if header[name] != word:
            found = str(header[name])[:80]
            raise ValueError(f"kinematics.{name}: found {found!r}, possible: {word}")
    if _BASE_NAMES[0] not in header:
        return {name: header[name] for name in _NAMES} | marks
    carried = all(isinstance(header.get(name), str) for name in _BASE_NAMES)
    if not carried or header[_BASE_NAMES[-1]] not in _THINGS:
        raise ValueError(
            f"kinematics: found {str(header)[:80]}, possible: texts for {', '.join(_BASE_NAMES)}"
        )
    if _STILL in header and not isinstance(header[_STILL], str):
        raise ValueError(f"kinematics.{_STILL}: found {str(header[_STILL])[:80]}, possible: a text")
    names = (*_NAMES, *_BASE_NAMES, *((_STILL,) if _STILL in header else ()))
    return {name: header[name] for name in names} | marks


def insist_rigid(poses: Array, field: str) -> None:
    """ValueError unless poses (4,4) or (K,4,4) turn and
    move, without scaling, and not beyond _FARTHEST.
    """
    poses = poses.reshape(-1, 4, 4)
    turn = poses[:, :3, :3]
    place = poses[:, :3, 3]
    with np.errstate(over="ignore", invalid="ignore"):
        stretch = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0)
        mirrored = (np.linalg.det(turn) < 0.0).any()
    rigid = stretch <= _ROUNDING and not mirrored and (poses[:, 3] == (0.0, 0.0, 0.0, 1.0)).all()
    insist_sound(
        rigid,
        field,
        "a matrix that is no pose",
        "a rotation and a place, above a row of 0, 0, 0, 1",
    )
    farthest = float(np.abs(place).max(initial=0.0))
    insist_sound(farthest <= _FARTHEST, field, f"{farthest:g} m", f"at most {_FARTHEST:g} m")


_ROUNDING = 1e-6
"""How far a product of rotations may be from a rotation; a learned body's are within 1e-14."""
_FARTHEST = 1e4
"""m: no camera sees a marker from farther away."""
_LARGEST = 1e6
"""Unknowns (m, rad, px, shares), and a step's scale and zero."""


def insist_sound(sound: Any, field: str, found: object, possible: str) -> None:
    """ValueError, naming the field, unless it is sound."""
    if not sound:
        raise ValueError(f"{field}: found {found}, possible: {possible}")
