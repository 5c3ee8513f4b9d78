"""Stage: body. Forward models of the senses, learned from exploration logs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ..body_model import UNUSED_URDF, WITHOUT_URDF, BodyModel
from ..errors import EvidenceError
from ..settings import Settings
from ..types import Features, Finding
from .senses.encoder_function import Polynomial

if TYPE_CHECKING:
    from .kinematic.learn import Robotics
    from .learning import Keep, LearnedBody

__all__ = ["Polynomial", "learn_body", "with_kinematics"]

NAME_URDF = "give the robot's URDF with --urdf"
"""What to do where no URDF was given."""


def learn_body(
    features: Sequence[Features],
    settings: Settings,
    provenance: Mapping[str, Any],
    update: BodyModel | None = None,
    keep: "Keep" = "explained",
    advice: str = "",
    lasting: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> "LearnedBody":
    """Call `learning.learn_from_features`; the import
    is late, since predicting needs none of it.
    """
    from . import learning

    return learning.learn_from_features(
        features, settings, provenance, update, keep, advice, lasting
    )


def with_kinematics(
    features: Sequence[Features],
    settings: Settings,
    found: "LearnedBody",
    robot: "Robotics | None",
    update: BodyModel | None = None,
) -> "LearnedBody":
    """Add the URDF's kinematics to a learned body; without a URDF, or with
    an unsuitable one, axes of the joints that are found from the tracks.

    A body to update keeps its own chain unless a URDF is requested. Tracks
    that kinematics do not explain are refused where a Gaussian process
    does not explain them, or where they tell nothing about the joints.
    """
    with_it = _with_urdf(features, settings, found, robot, update)
    from .kinematic import found_axes
    from .kinematic.update import senses_with_chain

    if senses_with_chain(with_it.model):
        return with_it
    return found_axes.learn_axes(with_it, features, settings)


def _with_urdf(
    features: Sequence[Features],
    settings: Settings,
    found: "LearnedBody",
    robot: "Robotics | None",
    update: BodyModel | None,
) -> "LearnedBody":
    """The body with the URDF's kinematics, or without tracks that need them."""
    doubtful = {**found.poor, **found.vague}
    judged = replace(found, poor=doubtful) if found.vague else found
    with_it = _learn_or_update_kinematics(features, settings, judged, robot, update)
    if with_it.model is not found.model:
        return with_it
    unused = with_it.findings[len(found.findings) :]
    if not doubtful:
        return _record_unused_urdf(with_it, unused)
    try:
        plain = learn_body(
            features,
            settings,
            found.model.provenance,
            update,
            "telling",
            _advise_on_vague_track(settings, robot),
            found.lasting,
        )
    except EvidenceError as problem:
        raise EvidenceError(
            "; ".join([str(problem), *map(_reason_urdf_unused, unused)])
        ) from problem
    return _record_unused_urdf(replace(plain, findings=(*plain.findings, *unused)), unused)


def _advise_on_vague_track(settings: Settings, robot: "Robotics | None") -> str:
    """What to do about a track that tells nothing: another URDF is no advice to who gave one."""
    more = "record more poses"
    if robot is not None:
        return more
    return f"{more}, or {NAME_URDF if settings.kinematics.use else 'leave out --no-urdf'}"


def _record_unused_urdf(found: "LearnedBody", unused: Sequence[Finding]) -> "LearnedBody":
    """The body, which knows why a URDF that it was given is not used."""
    if not unused:
        return found
    provenance = {**found.model.provenance, UNUSED_URDF: _reason_urdf_unused(unused[0])}
    return replace(found, model=replace(found.model, provenance=provenance))


def _reason_urdf_unused(unused: Finding) -> str:
    """Why a URDF is not used, without the advice to
    leave it out, of no use where a URDF is needed.
    """
    return unused.text.removesuffix(f", {WITHOUT_URDF}")


def _learn_or_update_kinematics(
    features: Sequence[Features],
    settings: Settings,
    found: "LearnedBody",
    robot: "Robotics | None",
    update: BodyModel | None,
) -> "LearnedBody":
    if settings.kinematics.use and (robot is None or not robot.asked) and update is not None:
        from .kinematic import update as kinematic_update

        if kinematic_update.senses_with_chain(update):
            return kinematic_update.update_kinematics(features, settings, found, update)
    if robot is None:
        return found
    from .kinematic import learn as kinematic

    return kinematic.learn_kinematics(features, settings, found, robot)
