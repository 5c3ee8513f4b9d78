"""The joints' zeros that a body learned with a URDF tells."""

from typing import Any

from ..errors import ModelError
from ..kinematics.identifiability import Offset, offsets
from ..types import BodyModel
from .kinematic_gp import KinematicGP


def learned(model: BodyModel) -> tuple[Offset, ...]:
    """Each joint's zero; tracks were learned together, so any of them tells. ModelError without a URDF's chain."""
    senses = [sense for sense in model.senses.values() if isinstance(sense, KinematicGP)]
    if not senses:
        raise ModelError("learned without a URDF, it tells no joint offsets; type: bodylog fit LOG --urdf ROBOT.urdf")
    first = senses[0]
    return offsets(first.rig, first.theta, first.root @ first.root.T)


def plain(found: "tuple[Offset, ...]") -> dict[str, dict[str, Any]]:
    """As plain values: {joint: value (None where it is not identifiable), std, unit, identifiable, confused with}."""
    return {
        one.joint: {
            "value": one.value if one.identifiable else None,
            "std": one.std,
            "unit": one.unit,
            "identifiable": one.identifiable,
            "confused_with": list(one.confused),
        }
        for one in found
    }
