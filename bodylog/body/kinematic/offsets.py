"""Joint zeros and scales of a body learned with a URDF."""

from typing import Any

from ...body_model import BodyModel
from ...kinematics.identifiability import Offset
from .placements import calibration


def learned(model: BodyModel) -> tuple[Offset, ...]:
    """Each joint's zero, which all tracks share. ModelError without a URDF's chain."""
    return calibration(model).zeros


def scaled(model: BodyModel) -> tuple[Offset, ...]:
    """Each joint's scale; empty where scales are fixed. ModelError without a URDF's chain."""
    return calibration(model).scales


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


def tables(found: "tuple[Offset, ...]", scales: "tuple[Offset, ...]") -> dict[str, dict[str, dict[str, Any]]]:
    """As plain values: {"offsets": {joint: …}}, and "scales" if there are any."""
    return {"offsets": plain(found)} | ({"scales": plain(scales)} if scales else {})
