"""Joint zeros and scales of a body learned with a URDF."""

from typing import Any

from ...body_model import BodyModel
from ...kinematics.identifiability import Offset
from .placements import calibration_of_body


def learned_zeros(model: BodyModel) -> tuple[Offset, ...]:
    """Each joint's zero, which all tracks share. ModelError without a URDF's chain."""
    return calibration_of_body(model).zeros


def learned_scales(model: BodyModel) -> tuple[Offset, ...]:
    """Each joint's scale; empty where scales are fixed. ModelError without a URDF's chain."""
    return calibration_of_body(model).scales


def offsets_as_values(found: "tuple[Offset, ...]") -> dict[str, dict[str, Any]]:
    """As plain values: {joint: value (None where it is not
    identifiable), std, unit, identifiable, confused with}.
    """
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


def offset_tables(
    found: "tuple[Offset, ...]", scales: "tuple[Offset, ...]"
) -> dict[str, dict[str, dict[str, Any]]]:
    """As plain values: {"offsets": {joint: …}}, and "scales" if there are any."""
    return {"offsets": offsets_as_values(found)} | (
        {"scales": offsets_as_values(scales)} if scales else {}
    )
