"""Calibrate a log's cameras by the robot's own surface: no marker, any motion, a URDF."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import EvidenceError, ModelError
from .types import Array, Frame, Recording, Series

if TYPE_CHECKING:
    from .kinematics.joint_motion import JointMotion
    from .kinematics.landmark_fit import LandmarkFit
    from .kinematics.landmarks import LandmarkModel, Sightings
    from .kinematics.links import CameraHint
    from .kinematics.rig import Camera
    from .kinematics.robot import Robot
    from .perception.surface.corner_tracks import CornerTracks
    from .settings import Settings

LONGEST_S = 60.0
"""The middle of a log that is used."""
MOST_IMAGES = 1800
ROW_STRIDE = 2
"""Every n-th row of a piece is used: errors of neighbours are alike."""
_SEARCH_PIECES = 80
_SEARCH_STRIDE = 4
_GRID_S = 0.01
"""Spacing of the smoothed joint angles."""
_LEAST_RANGE = 0.02
"""rad or m that a joint moves at least to count as moving."""
_LEAST_SHARE = 0.25
"""Share of the moving pieces that the robot must explain."""
_CONTROL_RATIO = 0.6
"""Most pieces that the joints of another time may explain, as a share of those that the joints explain."""
_CONTROL_PIECES = 120


@dataclass(frozen=True, eq=False)
class SurfaceCalibration:
    """A camera's calibration by the surface: the fit, the covariance (P,P) of its unknowns φ, and what it is based on.

    camera: its name, "" the first · moving: pieces that moved · joint_of {name in the log: joint in the URDF}.
    """

    camera: str
    fit: "LandmarkFit"
    covariance: Array
    moving: int
    joint_of: Mapping[str, str]
    still_joints: tuple[str, ...]


def calibrate_cameras(log: Path, read: Recording, settings: "Settings") -> Iterator[SurfaceCalibration | EvidenceError]:
    """Yield each camera's calibration, or why there is none. ModelError where no joint of the URDF is in the log."""
    from .robot_model import named_robot

    robot = named_robot(log, settings)
    joint_of, motion, still = moving_joints(log, read, robot)
    films = {"": read.frames, **read.views}
    for name, film in films.items():
        if film is None:
            continue
        try:
            tracks = _tracked(log, name, film)
            hint = camera_hints(log, robot, read, settings).get(name)
            fit, moving = _calibrated(log, name, robot, motion, joint_of, still, tracks, hint, settings)
        except EvidenceError as problem:
            yield problem
            continue
        from .kinematics.landmark_errors import unknowns_covariance

        names = tuple(joint for joint in robot.by_name if joint in still)
        yield SurfaceCalibration(name, fit, unknowns_covariance(fit), moving, joint_of, names)


def camera_hints(log: Path, robot: "Robot", read: Recording, settings: "Settings") -> "dict[str, CameraHint]":
    """What a log says of its cameras' links, poses and lenses, by name, "" the first, of which [camera] tells too."""
    from .kinematics.links import CameraHint
    from .known_camera import with_known
    from .recording.robot_description import described
    from .robot_model import told_camera

    description = described(log, settings.input)
    topics = {role.partition("/")[2]: path for role, path in read.roles.items() if role.partition("/")[0] == "camera"}
    told = {name: told_camera(topic, description, robot) for name, topic in topics.items()}
    hints = {name: hint for name, hint in told.items() if hint is not None}
    return {**hints, "": with_known(hints.get("", CameraHint()), settings.camera, robot)}


def moving_joints(
    log: Path, read: Recording, robot: "Robot"
) -> "tuple[dict[str, str], JointMotion, dict[str, float]]":
    """The log's joints that move, with their names in the URDF, as curves; the angles, rad, of those at rest.

    ModelError where the URDF has none of the log's joints, EvidenceError where none moves.
    """
    import numpy as np

    from .kinematics.joint_names import match_joints
    from .kinematics.robot import MOVING

    joints = read.joints
    if joints is None:
        raise EvidenceError(f"{log}: no joint states in it; the surface of a robot needs them")
    known = [joint.name for joint in robot.joints if joint.kind in MOVING and joint.mimic is None]
    joint_of = match_joints(joints.names, known)
    if not joint_of:
        names, have = ", ".join(joints.names[:12]), ", ".join(known[:12])
        raise ModelError(f"{robot.source}: none of the joints of {log} ({names}) is in it; it has {have}")
    columns = {name: joints.values[:, list(joints.names).index(name)] for name in joint_of}
    ranges = {name: _range(column) for name, column in columns.items()}
    still = {joint_of[name]: float(np.nanmedian(columns[name])) for name in joint_of if ranges[name] < _LEAST_RANGE}
    moving = {name: joint for name, joint in joint_of.items() if ranges[name] >= _LEAST_RANGE}
    if not moving:
        raise EvidenceError(f"{log}: none of its joints moves; the surface of a robot tells nothing then")
    return moving, smoothed_motion(joints, tuple(moving)), still


def _range(column: Array) -> float:
    import numpy as np

    finite = column[np.isfinite(column)]
    return float(np.ptp(np.percentile(finite, [2.0, 98.0]))) if len(finite) > 1 else 0.0


def smoothed_motion(joints: Series, names: Sequence[str]) -> "JointMotion":
    """The joints' angles as curves: integrated-Wiener smoothing, noise and motion by evidence."""
    import numpy as np

    from .body.data import angle_smoother
    from .kinematics.joint_motion import joint_motion

    grid = np.arange(joints.t[0], joints.t[-1], _GRID_S)
    columns = []
    for name in names:
        readings = joints.values[:, list(joints.names).index(name)]
        finite = np.isfinite(readings)
        signal = angle_smoother.chain(joints.t[finite], readings[finite])
        motion = angle_smoother.fit([signal], 3)
        columns.append(angle_smoother.posterior(signal, motion, grid)[0])
    return joint_motion(grid, np.stack(columns, axis=1))


def _tracked(log: Path, camera: str, film: Callable[[], Iterator[Frame]]) -> "CornerTracks":
    from .kinematics.landmark_fit import LEAST_PIECES
    from .perception.surface.corner_tracks import moving_pieces, track_corners

    tracks, _ = track_corners(film)
    moving = moving_pieces(tracks)
    if len(moving) < LEAST_PIECES:
        raise EvidenceError(
            f"{log}: {camera or 'camera'}: {len(moving)} corners move in its images; the surface needs {LEAST_PIECES}"
        )
    return tracks.take(moving)


def _calibrated(
    log: Path, name: str, robot: "Robot", motion: "JointMotion", joint_of: Mapping[str, str],
    still: Mapping[str, float], tracks: "CornerTracks", hint: "CameraHint | None", settings: "Settings",
) -> "tuple[LandmarkFit, int]":  # fmt: skip
    """The fit of one camera, and the number of pieces it was tried on; EvidenceError where the arm is not seen."""
    from math import radians

    from .kinematics.landmark_fit import MOST_PIECES, build_model, choose_pieces
    from .kinematics.landmarks import sightings
    from .kinematics.links import CameraHint, Space

    zero_std = radians(settings.kinematics.offset_prior)
    space = Space(robot, tuple(joint_of.values()), dict(still), zero_std)
    hint = replace(hint or CameraHint(), size=tracks.size)
    seen = sightings([(tracks.piece, tracks.t[tracks.frame], tracks.uv)], tracks.size[1])
    part = seen.take(choose_pieces(seen, MOST_PIECES)).thinned(ROW_STRIDE)
    few = seen.take(choose_pieces(seen, _SEARCH_PIECES)).thinned(_SEARCH_STRIDE)
    best: LandmarkFit | None = None
    for cameras in _start_cameras(name or "camera", robot, space, hint):
        models = [build_model(space, camera, [motion], zero_std) for camera in cameras[:1]]
        for found in _fits(models[0], cameras, few, part):
            if best is None or len(found.used) > len(best.used):
                best = found
        if best is not None and len(best.used) >= _LEAST_SHARE * part.count:
            break
    where = f"{log}: {name or 'camera'}"
    if best is None or len(best.used) < _LEAST_SHARE * part.count:
        count = 0 if best is None else len(best.used)
        raise EvidenceError(f"{where}: the joints explain {count} of {part.count} moving corners; no arm is seen")
    control = _control(best, part)
    if control > _CONTROL_RATIO * len(best.used):
        text = f"the joints of another time explain the corners as well ({control} against {len(best.used)})"
        raise EvidenceError(f"{where}: {text}; the images do not belong to the joints")
    return best, part.count


def _start_cameras(
    name: str, robot: "Robot", space: object, hint: "CameraHint"
) -> "Iterator[list[Camera]]":
    """Yield sets of cameras to start from, all on one link: as the log places it, on named links, around the arm."""
    import numpy as np

    from .kinematics.landmark_starts import around_the_arm, camera_links, free_camera, nominal_camera
    from .kinematics.links import hinted_camera

    if hint.link is not None:
        yield [hinted_camera(name, hint.link, hint, robot)]
    for link in camera_links(robot)[:2]:
        yield [nominal_camera(name, link, hint, robot)]
    yield list(around_the_arm(free_camera(name, hint, robot), np.array([0.0, 0.0, 0.3])))


def _fits(
    model: "LandmarkModel", cameras: "Sequence[Camera]", few: "Sightings", part: "Sightings"
) -> "Iterator[LandmarkFit]":
    from .kinematics.landmark_fit import staged_fit
    from .kinematics.landmark_starts import best_starts

    for start, phi, _ in best_starts(model, few, cameras):
        found = staged_fit(start, phi, part, wide=len(cameras) > 1)
        if found is not None:
            yield found


def _control(best: "LandmarkFit", part: "Sightings") -> int:
    """Pieces that the same robot explains with the joints of another time: half the log later, in a circle."""
    from .kinematics.landmark_fit import choose_pieces, staged_fit
    from .kinematics.landmarks import LandmarkModel

    motions = tuple(shifted_motion(motion) for motion in best.model.motions)
    model = LandmarkModel(best.model.rig, best.model.bodies, motions)
    few = part.take(choose_pieces(part, _CONTROL_PIECES))
    found = staged_fit(model, best.phi, few)
    return 0 if found is None else round(len(found.used) * part.count / few.count)


def shifted_motion(motion: "JointMotion") -> "JointMotion":
    """The motion half its length later, in a circle."""
    import numpy as np

    from .kinematics.joint_motion import joint_motion

    return joint_motion(motion.t, np.roll(motion.q, len(motion.t) // 2, axis=0))
