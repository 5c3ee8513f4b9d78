"""Stage: body. What the robot should see, learned from exploration logs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..body_model import BodyModel
from ..settings import Settings
from ..types import Features
from .senses.encoder_function import Polynomial

if TYPE_CHECKING:
    from .kinematic.learn import Robotics
    from .learning import Learned

__all__ = ["Polynomial", "learn", "with_kinematics"]


def learn(
    features: Sequence[Features],
    settings: Settings,
    provenance: Mapping[str, Any],
    update: BodyModel | None = None,
    hopeful: bool = False,
) -> "Learned":
    """`learning.learn`, imported when there is something to learn from: predicting needs none of it."""
    from . import learning

    return learning.learn(features, settings, provenance, update, hopeful)


def with_kinematics(
    features: Sequence[Features],
    settings: Settings,
    found: "Learned",
    robot: "Robotics | None",
    update: BodyModel | None = None,
) -> "Learned":
    """`kinematic.learn` of a body learned without a URDF; that body itself where there is none, or it is unfit.

    A body to update keeps its own chain unless a URDF is asked for.
    Tracks that only kinematics could have explained are then refused, as they are where there is no URDF.
    """
    with_it = _with_kinematics(features, settings, found, robot, update)
    if with_it.model is not found.model or not found.poor:
        return with_it
    plain = learn(features, settings, found.model.provenance, update)
    return replace(plain, findings=(*plain.findings, *with_it.findings[len(found.findings) :]))


def _with_kinematics(
    features: Sequence[Features],
    settings: Settings,
    found: "Learned",
    robot: "Robotics | None",
    update: BodyModel | None,
) -> "Learned":
    if settings.kinematics.use and (robot is None or not robot.asked) and update is not None:
        from .kinematic import update as kinematic_update

        if kinematic_update.chained(update):
            return kinematic_update.learn(features, settings, found, update)
    if robot is None:
        return found
    from .kinematic import learn as kinematic

    return kinematic.learn(features, settings, found, robot)
