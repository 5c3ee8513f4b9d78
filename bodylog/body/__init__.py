"""Stage: body. Forward models of the senses, learned from exploration logs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..body_model import BodyModel
from ..settings import Settings
from ..types import Features
from .senses.encoder_function import Polynomial

if TYPE_CHECKING:
    from .kinematic.learn import Robotics
    from .learning import Keep, Learned

__all__ = ["Polynomial", "learn", "with_kinematics"]


def learn(
    features: Sequence[Features], settings: Settings, provenance: Mapping[str, Any], update: BodyModel | None = None,
    keep: "Keep" = "explained",
) -> "Learned":  # fmt: skip
    """Call `learning.learn`; the import is late, since predicting needs none of it."""
    from . import learning

    return learning.learn(features, settings, provenance, update, keep)


def with_kinematics(
    features: Sequence[Features], settings: Settings, found: "Learned", robot: "Robotics | None",
    update: BodyModel | None = None,
) -> "Learned":  # fmt: skip
    """Add the URDF's kinematics to a learned body; return it unchanged without a URDF, or with an unsuitable one.

    A body to update keeps its own chain unless a URDF is requested. Tracks that kinematics do not explain are refused
    where a Gaussian process does not explain them, or where they tell nothing about the joints.
    """
    doubtful = {**found.poor, **found.vague}
    judged = replace(found, poor=doubtful) if found.vague else found
    with_it = _with_kinematics(features, settings, judged, robot, update)
    if with_it.model is not found.model or not doubtful:
        return with_it
    plain = learn(features, settings, found.model.provenance, update, "telling")
    return replace(plain, findings=(*plain.findings, *with_it.findings[len(found.findings) :]))


def _with_kinematics(
    features: Sequence[Features], settings: Settings, found: "Learned", robot: "Robotics | None",
    update: BodyModel | None,
) -> "Learned":  # fmt: skip
    if settings.kinematics.use and (robot is None or not robot.asked) and update is not None:
        from .kinematic import update as kinematic_update

        if kinematic_update.chained(update):
            return kinematic_update.learn(features, settings, found, update)
    if robot is None:
        return found
    from .kinematic import learn as kinematic

    return kinematic.learn(features, settings, found, robot)
