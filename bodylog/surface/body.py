"""Learn a body by the robot's own surface: cameras
on a URDF, encoder noise and motion, no track.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..body_model import BodyModel, Surface, SurfaceCamera, TouchConstants
from ..delays.findings import middle_of_recording
from ..errors import EvidenceError
from ..settings import Settings
from ..sources import SurfaceSource
from ..types import Features, Finding, Recording, Score
from .calibration import LONGEST_S, MOST_IMAGES, SurfaceCalibration, calibrate_cameras
from .findings import findings_of, scores_of

if TYPE_CHECKING:
    from ..body.learning import LearnedBody

_BY_LINK = "rmse/kinematics/"
_LOOSE_RATIO = 2.0
"""Error of a track as a point of its link over its error with the residual process: balls and tags
0.9, poses of a bent NAO 1.5, a patch of colour on a gripper 3.6.
"""


def is_asked(settings: Settings) -> bool:
    """Whether [features] names the robot's surface."""
    return any(isinstance(source, SurfaceSource) for source in settings.features.values())


def without_surface(settings: Settings) -> Settings:
    """The settings without the robot's surface among their features."""
    features = {
        name: source
        for name, source in settings.features.items()
        if not isinstance(source, SurfaceSource)
    }
    return replace(settings, features=features)


def describe_loose_marker(scores: Sequence[Score]) -> str | None:
    """Why a marker that nobody named is no point of a link, by a body's scores; None where it is one.

    A patch of colour slides over its link as it turns, and the process learns that by posture. In
    other postures such a body misjudges encoders, where the surface's landmarks do not.
    """
    from .map import MOST_ERROR_PX

    by_name = {score.name: score.value for score in scores}
    for name, rigid in by_name.items():
        if not name.startswith(_BY_LINK):
            continue
        track = name.removeprefix(_BY_LINK)
        corrected = by_name.get(f"rmse/held_out/{track}", rigid)
        if rigid > max(MOST_ERROR_PX, _LOOSE_RATIO * corrected):
            return (
                f"{track}: as a point of its link it is {rigid:.3g} px off, and {corrected:.3g} px "
                "where each posture has its own correction: it is no point of a link"
            )
    return None


def learn_surface_body(
    logs: Sequence[tuple[Path, Recording]],
    settings: Settings,
    provenance: Mapping[str, Any],
    leave_out: bool = False,
) -> "LearnedBody":
    """Learn a body whose only sense beside the encoders is the robot's surface; `leave_out`: from
    the logs alone that show it, where others do not.

    EvidenceError where no camera shows the arm, or one shows another motion; ModelError where the
    URDF has no joint of a log.
    """
    from ..body.learning import LearnedBody
    from ..body.surface import joint_noise

    found = _calibrate_all_cameras(logs, settings, leave_out=leave_out)
    features = [Features(read.signals.joints, {}, None, (), (), {}) for _, read in logs]
    names = tuple(found[0].joint_of)
    first, read = logs[0]
    about = {
        "cameras": [
            topic for topic in (_find_image_topic(read, one.camera) for one in found) if topic
        ],
        **provenance,
    }
    model = BodyModel(
        names,
        {},
        joint_noise(features, names),
        TouchConstants(1.0, 0.005),
        about,
        surface=_build_surface(first, read, found, settings),
    )
    paths = [log for log, _ in logs]
    return LearnedBody(model, *_scores_and_findings(found, paths))


def add_surface(
    learned: "LearnedBody", logs: Sequence[tuple[Path, Recording]], settings: Settings
) -> "LearnedBody":
    """A body that was learned by markers, with the robot's surface as one more sense.

    Errors as of `learn_surface_body`; ModelError also where the URDF lacks one of its joints.
    """
    found = _calibrate_all_cameras(logs, settings, learned.model.joints)
    surface = _build_surface(*logs[0], found, settings)
    scores, findings = _scores_and_findings(found, [log for log, _ in logs])
    taken = {score.name for score in learned.scores}
    return replace(
        learned,
        model=replace(learned.model, surface=surface),
        scores=(*learned.scores, *(score for score in scores if score.name not in taken)),
        findings=(*learned.findings, *findings),
    )


def _calibrate_all_cameras(
    logs: Sequence[tuple[Path, Recording]],
    settings: Settings,
    joints: tuple[str, ...] | None = None,
    leave_out: bool = False,
) -> list[SurfaceCalibration]:
    """Each camera's calibration; EvidenceError without any, or where one shows no arm."""
    whole = [(log, middle_of_recording(read, LONGEST_S, MOST_IMAGES)) for log, read in logs]
    found = list[SurfaceCalibration]()
    for one in calibrate_cameras(whole, settings, leave_out, joints):
        if isinstance(one, EvidenceError):
            raise one
        found.append(one)
    if not found:
        raise EvidenceError(f"{logs[0][0]}: no images in it; the surface of a robot needs a camera")
    return found


def _scores_and_findings(
    found: Sequence[SurfaceCalibration], paths: Sequence[Path]
) -> tuple[tuple[Score, ...], tuple[Finding, ...]]:
    scores = tuple(score for one in found for score in _calibration_scores(one, paths))
    findings = tuple(
        finding
        for one in found
        for finding in (
            *(Finding("warning", f"{text}; it is left out") for text in one.left_out),
            *(Finding("info", text.text) for text in findings_of(one)),
        )
    )
    return scores, findings


def _build_surface(
    log: Path, read: Recording, found: Sequence[SurfaceCalibration], settings: Settings
) -> Surface:
    from math import radians

    from ..kinematics.urdf import kinematic_text
    from ..robot.model import named_urdf

    cameras = tuple(
        _build_surface_camera(one, _find_image_topic(read, one.camera)) for one in found
    )
    first = found[0]
    zero_std = radians(settings.kinematics.offset_prior)
    return Surface(
        kinematic_text(named_urdf(log, settings)), first.joint_of, first.still, zero_std, cameras
    )


def _build_surface_camera(one: SurfaceCalibration, topic: str) -> SurfaceCamera:
    import numpy as np

    model = one.fit.model
    phi = one.fit.phi
    placed = model.rig.cameras[0]
    delays = np.arange(model.of_delays.start, model.of_delays.stop)
    shared = np.setdiff1d(np.arange(model.of_moves.start), delays)
    assert one.picture is not None
    return SurfaceCamera(
        one.camera or "camera",
        topic,
        placed.link,
        one.size,
        placed.anchor,
        placed.lens,
        placed.doubt,
        phi[shared],
        one.covariance[np.ix_(shared, shared)],
        one.delays,
        one.delay_std,
        one.picture.astype(np.float64),
        one.landmarks,
    )


def _find_image_topic(read: Recording, camera: str) -> str:
    """The topic of a camera's images, "" the first's."""
    for role, path in read.facts.roles.items():
        kind, _, name = role.partition("/")
        if kind == "camera" and name == camera:
            return path
    return ""


def _calibration_scores(one: SurfaceCalibration, logs: Sequence[Path]) -> Iterator[Score]:
    """Its scores, with the delays of the logs as one each, by their numbers, where there are
    several."""
    yield from scores_of(one)
    name = one.camera or "camera"
    for log, seconds, std in zip(one.logs[1:], one.delays[1:], one.delay_std[1:], strict=True):
        number = logs.index(log) + 1
        yield Score(f"delay/{name}/{number}", float(seconds), "s", float(std))
