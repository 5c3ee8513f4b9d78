"""Kinematic results of an estimate: effector poses in metres,
predictions without the residual process, joint zeros.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

from ..body_model import BodyModel
from ..types import Array, Estimate, Poses, Series

if TYPE_CHECKING:
    from ..body.kinematic.model import KinematicGP

FIRST = "effector"


def add_kinematic_results(body: BodyModel, found: Estimate) -> Estimate:
    """Add kinematic results to an estimate; unchanged for a body learned without a URDF."""
    from ..body.kinematic.model import KinematicGP
    from ..body.kinematic.offsets import learned_zeros, offsets_as_values

    senses = {name: s for name, s in body.senses.items() if isinstance(s, KinematicGP)}
    if not senses or not len(found.joints.t):
        return found
    used = {**found.settings, "offsets": offsets_as_values(learned_zeros(body))}
    kinematic = {
        name: _predict_by_kinematics(senses[name], found, name)
        for name in found.predicted
        if name in senses
    }
    return replace(
        found, effector=_effector_poses(senses, found), kinematic=kinematic, settings=used
    )


def _effector_poses(senses: "dict[str, KinematicGP]", found: Estimate) -> Poses | None:
    """Poses of the effector, or of the first track by name."""
    from ..kinematics.pose import pose_in_base
    from ..kinematics.rotations import quaternions_from_rotations

    first = senses.get(FIRST, senses[min(senses)])
    if first.base is None:
        return None
    joints = found.joints
    chain = first.base.chain
    place, rotation, cov = pose_in_base(
        first.base, first.rig, first.printed, first.root, joints.values, found.cov
    )
    return Poses(
        joints.t, place, quaternions_from_rotations(rotation), chain.start, joints.source_ns, cov
    )


def _predict_by_kinematics(sense: "KinematicGP", found: Estimate, name: str) -> Series:
    """A track's predictions by kinematics alone, px: without the residual process."""
    import numpy as np

    predicted = found.predicted[name]
    joints = found.joints
    x = np.column_stack([np.interp(predicted.t, joints.t, column) for column in joints.values.T])
    process: Array = sense.means(x)[0] - sense.kinematics(x)
    return replace(predicted, values=predicted.values - process, std=None)
