"""The body of a robot that nothing but its encoders shows."""

import numpy as np

from ..body_model import BodyModel, Noise, TouchConstants
from ..errors import UsageError
from ..settings import Settings
from ..types import Recording, Series
from .joint_limits import ENCODER_STEP_RAD


def body_of_encoders(read: Recording, settings: Settings) -> BodyModel:
    """A body of all joints with readings, or those wanted,
    without other senses; UsageError for an unknown joint.
    """
    from .. import estimation

    assert read.signals.joints is not None
    mute = list_mute_joints(read.signals.joints)
    wanted = settings.body.joints
    known = [name for name in read.signals.joints.names if name not in mute]
    if unknown := [name for name in wanted or () if name not in known]:
        raise UsageError(
            f"[body] joints: found {unknown[0]!r}, possible: {', '.join(known)}; type: "
            "bodylog info LOG"
        )
    names = tuple(wanted or known)
    # joints that never move keep this process noise, 1 rad²/s³; others learn theirs
    noise = Noise((ENCODER_STEP_RAD**2 / 12.0,) * len(names), {}, (1.0,) * len(names))
    found = BodyModel(names, {}, noise, TouchConstants(1.0, 0.005), {})
    estimation.check_estimation_settings(found, settings.estimate)
    return found


def list_mute_joints(joints: Series) -> list[str]:
    """The joints none of whose readings is a number."""
    return [
        name
        for name, y in zip(joints.names, joints.values.T, strict=True)
        if not np.isfinite(y).any()
    ]
