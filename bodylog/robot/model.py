"""The robot of a body: its URDF, from a file or the log, and cameras as the log describes them."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..body_model import BodyModel
from ..errors import FormatError, LogError, ModelError
from ..kinematics import urdf
from ..kinematics.frame_robot import frame_robot
from ..kinematics.joint_names import match_joints
from ..kinematics.links import CameraHint
from ..kinematics.robot import Limits, Robot
from ..logs.tables.frame_columns import frame_of
from ..settings import Settings
from ..types import Array, Features, Finding
from ..wording import UNUSABLE_URDF, list_in_words

if TYPE_CHECKING:
    from ..body.kinematic.learn import Robotics
    from ..recording.robot_description import CameraInfo, Described


FROM_LOG = "log"
"""Stands for the log's own /robot_description."""


def urdf_files(settings: Settings) -> tuple[Path, ...]:
    """The URDF's file, if one is named and used."""
    urdf = settings.kinematics.urdf if settings.kinematics.use else None
    return () if urdf in (None, FROM_LOG) else (Path(str(urdf)),)


def find_robot(
    logs: Sequence[Path], features: Sequence[Features], settings: Settings
) -> "tuple[Robotics | None, tuple[Finding, ...]]":
    """The robot, or None without a URDF or if it is not to be used; a remark on an unsuitable one.

    A log's own URDF is used by default. FormatError where a requested URDF cannot be read, LogError
    where the log's own is requested but missing.
    """
    chosen = settings.kinematics
    if not chosen.use or settings.fit.preset == "paper":
        return None, ()
    from ..body.kinematic.learn import Robotics
    from ..recording.robot_description import read_robot_description
    from .known_camera import known_markers

    descriptions = [read_robot_description(log, settings.input) for log in logs]
    if (known := _robot_of_frame(logs, features)) is not None and chosen.urdf is None:
        hints = _build_camera_hints(known, descriptions, features, settings)
        markers = known_markers(settings.marker, features, known)
        return Robotics(known, hints, 0.0, True, 0.0, markers), ()
    texts = [(log, one.urdf) for log, one in zip(logs, descriptions, strict=True) if one.urdf]
    if chosen.urdf not in (None, FROM_LOG):
        found = urdf.load_urdf(Path(str(chosen.urdf)), settings.input)
    elif texts:
        try:
            found = _parse_logged_urdf(*texts[0], settings)
        except (FormatError, ModelError) as problem:
            if chosen.urdf is not None:
                raise
            return None, (Finding("warning", f"{problem}; {UNUSABLE_URDF}"),)
    elif chosen.urdf is None:
        return None, ()
    else:
        raise LogError(_NO_URDF.format(logs[0]))
    asked = chosen.urdf is not None
    hints = _build_camera_hints(found, descriptions, features, settings)
    doubt = radians(chosen.offset_prior)
    markers = known_markers(settings.marker, features, found)
    return Robotics(found, hints, doubt, asked, chosen.scale_prior, markers), ()


def _robot_of_frame(logs: Sequence[Path], features: Sequence[Features]) -> Robot | None:
    """The robot of logs whose joints are the coordinates of one frame; None for other joints."""
    names = {found.joints.names for found in features if found.joints is not None}
    frames = {frame_of(one) for one in names}
    if len(names) > 1 and len(frames) == 1 and None not in frames:
        raise LogError(
            f"{logs[0]}: the poses of {frames.pop()} need other angles than those of other logs "
            f"({', '.join(sorted({one[4] for one in names}))}), as its x axis nears the base's z "
            "axis in one; learn from one of them, or put all poses into one table"
        )
    coordinates = names.pop() if len(names) == 1 else ()
    frame = frame_of(coordinates)
    return None if frame is None else frame_robot(frame, coordinates)


def joints_of_urdf(
    features: Sequence[Features], robot: "Robotics | None"
) -> tuple[list[Features], tuple[Finding, ...]]:
    """The features with joints in the chain's order, of tables
    without columns that a requested URDF does not know.

    Without effect where the URDF knows none of them.
    """
    kept = list[Features]()
    findings = list[Finding]()
    for found in features:
        joints = found.joints
        if robot is None or not robot.asked or not found.poses or joints is None:
            kept.append(found)
            continue
        known = [k for k, name in enumerate(joints.names) if name in robot.robot.by_name]
        others = [name for name in joints.names if name not in robot.robot.by_name]
        if known and others:
            names = tuple(joints.names[k] for k in known)
            found = replace(
                found, joints=replace(joints, values=joints.values[:, known], names=names)
            )
            what = "these columns are not in it, so they are no joints"
            findings.append(
                Finding("info", f"{robot.robot.source}: {what}: {list_in_words(others)}")
            )
        kept.append(found)
    return in_chain_order(kept, robot), tuple(findings)


def with_coordinates(settings: Settings, robot: "Robotics | None") -> Settings:
    """The settings with all six coordinates of a frame as
    joints: none may be left out, however little it moved.
    """
    names = () if robot is None else tuple(joint.name for joint in robot.robot.joints)
    if frame_of(names) is None or settings.body.joints is not None:
        return settings
    return replace(settings, body=replace(settings.body, joints=names))


def check_urdf(logs: Sequence[Path], settings: Settings) -> str | None:
    """Check a URDF before images are read: FormatError if
    it is invalid, ModelError without any of the joints.

    Why a marker cannot be placed on it, where it has a log's
    joints by names that are spelt otherwise; else None.
    """
    chosen = settings.kinematics
    if not chosen.use or chosen.urdf in (None, FROM_LOG) or settings.fit.preset == "paper":
        return None
    from ..recording.robot_description import read_robot_description

    found = urdf.load_urdf(Path(str(chosen.urdf)), settings.input)
    otherwise = None
    for log in logs:
        names = read_robot_description(log, settings.input).joints
        if not names or set(names) & set(found.by_name):
            continue
        matches = match_joints(names, found.by_name)
        if not matches:
            have = ", ".join(list(found.by_name)[:12]) or "none"
            raise ModelError(
                f"{chosen.urdf}: none of the joints of {log} ({', '.join(names)}) is in it; "
                f"it has {have}"
            )
        name, joint = next(iter(matches.items()))
        otherwise = (
            f"{log}: its {name} is {joint} in {chosen.urdf}; a marker needs joints of the same "
            "names"
        )
    return otherwise


def joint_limits_of_log(log: Path, settings: Settings) -> tuple[dict[str, Limits], str]:
    """Joint limits and their source, by the named URDF or else the log's own; empty without a URDF.

    FormatError where the named URDF cannot be read,
    LogError where the log's own is named but missing.
    """
    from ..recording.robot_description import read_robot_description

    chosen = settings.kinematics
    if not chosen.use:
        return {}, ""
    if chosen.urdf not in (None, FROM_LOG):
        found = urdf.load_urdf(Path(str(chosen.urdf)), settings.input)
        source = str(chosen.urdf)
    elif text := read_robot_description(log, settings.input).urdf:
        found = _parse_logged_urdf(log, text, settings)
        source = "/robot_description"
    elif chosen.urdf == FROM_LOG:
        raise LogError(_NO_URDF.format(log))
    else:
        return {}, ""
    return {joint.name: joint.limits for joint in found.joints if joint.limits is not None}, source


_NO_URDF = "{}: no /robot_description in it; give the URDF's file: --urdf ROBOT.urdf"


def _parse_logged_urdf(log: Path, text: str, settings: Settings) -> Robot:
    return urdf.parse_urdf(text, f"{log}: /robot_description", settings.input)


def with_robot_chain(
    body: BodyModel, known: "Robotics | None", features: Sequence[Features]
) -> BodyModel:
    """Add to each kinematic sense the chain from the robot's
    root, and the sizes of the images to the provenance.
    """
    if known is None:
        return body
    from ..body.kinematic.learn import still_joint_angles
    from ..body.kinematic.model import KinematicGP
    from ..body.kinematic.placements import IMAGE_SIZES, calibration_of_body
    from ..kinematics.pose import find_base

    held = still_joint_angles(features, body.joints)
    if any(isinstance(one, KinematicGP) for one in body.senses.values()):
        for zero in calibration_of_body(body).zeros:
            if zero.joint in held and zero.identifiable:
                held[zero.joint] += zero.value
    senses = {
        name: replace(one, base=find_base(known.robot, one.rig, one.printed, held))
        if isinstance(one, KinematicGP) and one.base is None
        else one
        for name, one in body.senses.items()
    }
    hints = known.hints.items()
    sizes = {
        f"camera {name}".strip(): list(hint.size) for name, hint in hints if hint.size is not None
    }
    return replace(body, senses=senses, provenance={**body.provenance, IMAGE_SIZES: sizes})


def in_chain_order(features: Sequence[Features], known: "Robotics | None") -> list[Features]:
    """The features with their joints in the order of the
    robot's chain, from its root on; those of no URDF stay last.

    Drivers publish joints alphabetically, or as they were configured.
    """
    if known is None:
        return list(features)
    place = {name: k for k, name in enumerate(known.robot.chain_order())}
    ordered = []
    for one in features:
        series = one.joints
        if series is not None:
            columns = sorted(
                range(len(series.names)), key=lambda k: place.get(series.names[k], len(place))
            )
            names = tuple(series.names[k] for k in columns)
            one = replace(
                one, joints=replace(series, values=series.values[:, columns], names=names)
            )
        ordered.append(one)
    return ordered


def list_joints_not_learned(body: BodyModel, features: Sequence[Features]) -> tuple[str, ...]:
    """Joints with readings over which the body was not learned, each once."""
    names = (name for one in features if one.joints is not None for name in one.joints.names)
    return tuple(name for name in dict.fromkeys(names) if name not in body.joints)


def _build_camera_hints(
    robot: Robot,
    descriptions: "Sequence[Described]",
    features: Sequence[Features],
    settings: Settings,
) -> dict[str, CameraHint]:
    """Hints on each camera by name, from the logs; on the first one from [camera] too."""
    from .known_camera import with_known

    tracks = [(name, one.unit) for found in features for name, one in found.tracks.items()]
    names = {name.rpartition("/")[0] for name, unit in tracks if unit == "px"}
    trackers = {name.rpartition("/")[0] for name, unit in tracks if unit == "mm"}
    topics = {name: topic for found in features for name, topic in found.cameras.items()}
    if len(names) == 1 and all(found.poses for found in features):
        # a table's lens is that of its only camera, whether it has images or places in them
        lenses = {topic.rpartition("/")[0] for one in descriptions for topic in one.cameras}
        topics = {name: f"{lens}/image" for name in names for lens in lenses} | topics
    hints = {}
    for name in sorted(names):
        size = next(
            (found.picture_size for found in features if found.picture_size and not name), None
        )
        camera_hints = [
            hint
            for one in descriptions
            if (hint := describe_logged_camera(topics.get(name), one, robot)) is not None
        ]
        hint = camera_hints[0] if camera_hints else CameraHint()
        if hint.size is None:
            hint = replace(hint, size=size, extent=_image_extent(name, features))
        hints[name] = hint if name else with_known(hint, settings.camera, robot)
    return hints | {name: _tracker_hint(name, robot, descriptions) for name in trackers}


def _tracker_hint(frame: str, robot: Robot, descriptions: "Sequence[Described]") -> CameraHint:
    """Where a frame of points in space is, if it is a link or fixed transforms lead to one."""
    for one in descriptions:
        link, pose = _find_mounting_link(frame, robot, one.transforms)
        if link is not None:
            return CameraHint(link, np.eye(4) if pose is None else pose)
    return CameraHint()


def named_robot(log: Path, settings: Settings) -> Robot:
    """The robot of the URDF that the settings name, or
    of the log's own. LogError where that is missing.
    """
    from ..recording.robot_description import read_robot_description

    chosen = settings.kinematics.urdf
    if chosen not in (None, FROM_LOG):
        return urdf.load_urdf(Path(str(chosen)), settings.input)
    text = read_robot_description(log, settings.input).urdf
    if not text:
        raise LogError(_NO_URDF.format(log))
    return _parse_logged_urdf(log, text, settings)


def named_urdf(log: Path, settings: Settings) -> str:
    """The text of the URDF that the settings name, or
    of the log's own. LogError where that is missing.
    """
    from ..recording.robot_description import read_robot_description

    chosen = settings.kinematics.urdf
    if chosen not in (None, FROM_LOG):
        return urdf.read_urdf_text(Path(str(chosen)))
    text = read_robot_description(log, settings.input).urdf
    if not text:
        raise LogError(_NO_URDF.format(log))
    return text


def describe_logged_camera(
    topic: str | None, description: "Described", robot: Robot
) -> CameraHint | None:
    """What a log's description says of an image topic's camera; None without its CameraInfo."""
    info = _find_camera_info(topic, description.cameras)
    if info is None:
        return None
    link, pose = _find_mounting_link(info.frame, robot, description.transforms)
    size = (info.width, info.height) if info.width and info.height else None
    return CameraHint(link, pose, _lens_of_info(info), size)


def _find_camera_info(
    topic: str | None, cameras: "Mapping[str, CameraInfo]"
) -> "CameraInfo | None":
    """The CameraInfo of an image topic."""
    from ..recording.cameras import camera_name_of_source

    if topic is None:
        return None
    known = {name.rpartition("/")[0].strip("/"): info for name, info in cameras.items()}
    return known.get(camera_name_of_source(topic))


def _image_extent(name: str, features: Sequence[Features]) -> tuple[int, int] | None:
    """An image size (px) that contains all positions; None without any."""
    seen = [
        track.values
        for found in features
        for other, track in found.tracks.items()
        if other.rpartition("/")[0] == name and track.unit == "px"
    ]
    values = np.concatenate(seen) if seen else np.empty((0, 2))
    with suppress(ValueError):
        width, height = np.nanmax(values, axis=0)
        return (640, 480) if width < 640 and height < 480 else (int(width * 1.1), int(height * 1.1))
    return None


def _find_mounting_link(
    frame: str, robot: Robot, transforms: "Mapping[str, tuple[str, Array]]"
) -> "tuple[str | None, Array | None]":
    """The link to which fixed transforms attach a frame,
    and its pose (4,4) there, None where it is that link.
    """
    pose = np.eye(4)
    seen = {frame}
    while frame not in robot.links and frame in transforms:
        frame, step = transforms[frame]
        pose = step @ pose
        if frame in seen:
            return None, None
        seen.add(frame)
    if frame not in robot.links:
        return None, None
    return frame, None if len(seen) == 1 else pose


def _lens_of_info(info: "CameraInfo") -> "Array":
    """The six lens parameters; distortion other than radial is ignored."""
    radial = (
        info.distortion[:2]
        if info.model == "plumb_bob" and len(info.distortion) > 1
        else np.zeros(2)
    )
    fu = info.matrix[0]
    fv = info.matrix[4]
    return np.array([np.log(fu), np.log(fv / fu), info.matrix[2], info.matrix[5], *radial])
