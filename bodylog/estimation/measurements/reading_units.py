"""How large one unit of joint readings is, so that
rules about angles hold for counts and degrees as well.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import tau
from typing import Any

import numpy as np

from ...types import Array, Estimate, Fault, Features, Series

JOINT_UNIT_KEY = "joint_unit"
"""The key of an estimate's settings that names the joints' unit, where that is not rad."""


def find_joint_unit(joints: Series | None) -> tuple[str, float]:
    """The unit of joint readings, and its size in rad, 1 where they are angles.

    The size of undeclared units is a guess: of a turn of the least power
    of two that holds all readings, as encoders count. A declared unit is
    rad; whole numbers that span more than a turn are counts all the same.
    """
    if joints is None or not np.isfinite(joints.values).any():
        return "rad", 1.0
    span = _measure_reading_span(joints.values)
    if joints.unit != "rad":
        return joints.unit, _guess_rad_per_unit(span)
    known = joints.values[np.isfinite(joints.values)]
    if span > tau and (known == np.round(known)).all():
        return "counts", _guess_rad_per_unit(span)
    return "rad", 1.0


def _measure_reading_span(values: Array) -> float:
    """The span of all readings (N,M) and of zero: of
    counts and of percent, zero is an end or the middle.
    """
    return max(float(np.nanmax(values)), 0.0) - min(float(np.nanmin(values)), 0.0)


def _guess_rad_per_unit(span: float) -> float:
    """The size (rad) of a unit, if a turn has the least power of two that holds the span."""
    return tau / 2.0 ** np.ceil(np.log2(span)) if span > tau else 1.0


def scale_to_angles(features: Features, rad_per_unit: float) -> Features:
    """The features with joint readings as angles, rad."""
    joints = features.joints
    assert joints is not None
    return replace(
        features, joints=replace(joints, values=rad_per_unit * joints.values, unit="rad")
    )


def convert_estimate_to_units(found: Estimate, unit: str, rad_per_unit: float) -> Estimate:
    """An estimate of angles, by encoders alone, in the unit that their readings have."""
    scale = 1.0 / rad_per_unit
    bias = None if found.bias is None else replace(found.bias, values=scale * found.bias.values)
    return replace(
        found,
        joints=replace(found.joints, values=scale * found.joints.values),
        rate=replace(found.rate, values=scale * found.rate.values),
        cov=scale**2 * found.cov,
        bias=bias,
        faults=tuple(convert_fault_to_units(fault, unit, scale) for fault in found.faults),
        settings=_convert_settings_to_units(found.settings, scale),
    )


def convert_fault_to_units(fault: Fault, unit: str, scale: float) -> Fault:
    """A fault of angles in a unit, of which a rad has `scale`."""
    std = None if fault.std is None else scale * fault.std
    return replace(fault, size=scale * fault.size, std=std, unit=unit)


def _convert_settings_to_units(settings: Mapping[str, Any], scale: float) -> dict[str, Any]:
    """The settings with variances of encoders and of motion in the readings' unit."""
    converted = dict(settings)
    for name in ("encoder", "process", "drift"):
        if isinstance(converted.get(name), list):
            converted[name] = [scale**2 * each for each in converted[name]]
    return converted
