"""Calibrate a log's cameras by the robot's own surface: no marker, any motion, a URDF."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import EvidenceError, ModelError
from ..types import Array, LazyImage, Recording, Series
from .map import build_map

if TYPE_CHECKING:
    from ..body_model import LandmarkMap
    from ..estimation.timing.delay_profile import Delay
    from ..kinematics.joint_motion import JointCurve
    from ..kinematics.landmark_fit import LandmarkFit
    from ..kinematics.landmarks import LandmarkModel, LandmarkSightings
    from ..kinematics.links import CameraHint
    from ..kinematics.rig import RigCamera
    from ..kinematics.robot import Robot
    from ..perception.surface.corner_tracks import CornerTracks, KeyFrames
    from ..settings import Settings

_MOST_KEPT_FRAMES = 240
"""Images of all logs together in which landmarks are looked for."""
_LEAST_KEPT_FRAMES = 20
"""Such images of one of many logs."""
LONGEST_S = 60.0
"""The middle of a log that is used."""
MOST_IMAGES = 1800
ROW_STRIDE = 2
"""Every n-th row of a piece is used: errors of neighbours are alike."""
SEARCH_PIECES = 80
"""Pieces by which starts and delays are compared."""
SEARCH_STRIDE = 4
"""Every n-th row of these pieces is used."""
_GRID_S = 0.01
"""Spacing of the smoothed joint angles."""
LEAST_RANGE = 0.02
"""rad or m that a joint moves at least to count as moving."""
_LEAST_SHARE = 0.25
"""Share of the moving pieces that the robot must explain."""
_LEAST_SHARE_OF_ONE = 0.15
"""Share of the moving pieces of one log of several that the robot must explain."""
_CONTROL_RATIO = 0.6
"""Most pieces that the joints of another time may
explain, as a share of those that the joints explain.
"""
_CONTROL_PIECES = 120
SAME_PICTURE_PX = 1.5
"""Shift of the still scene, px of the full image, within which a camera did not move."""
_LEAST_ALIKE = 0.9
"""Correlation of two pictures of one scene, the arm elsewhere; less is another scene."""
_BLUR_PX = 1.0
"""Blur of the shrunken pictures, so that pixels between others can be compared."""


@dataclass(frozen=True, eq=False)
class SurfaceCalibration:
    """A camera's calibration by the surface: the fit, the
    covariance (P,P) of its unknowns φ, and what it is based on.

    camera: its name, "" the first · logs: that show it, in the order of the fit's delays · moving:
    pieces that moved, and the share of them that the tracks' fit uses · size (width, height) px ·
    picture (h,w): median of the last log's images, shrunken and grey · joint_of {name in the logs:
    joint in the URDF} · still: angles, rad or m, of the joints at rest · delays (L,) s ± delay_std
    (L,), by tracks, which follow every image · landmarks: the map that the fit is of; None where it
    is of tracks, as too few landmarks are found again · seen: all pieces that moved · rolling: row
    time (s) by tracks, which the delays follow with slopes (L,) · left_out: why other logs teach
    nothing.
    """

    camera: str
    logs: tuple[Path, ...]
    fit: "LandmarkFit"
    covariance: Array
    moving: int
    used_share: float
    size: tuple[int, int]
    picture: Array | None
    joint_of: Mapping[str, str]
    still: Mapping[str, float]
    delays: Array
    delay_std: Array
    landmarks: "LandmarkMap | None"
    seen: "LandmarkSightings"
    rolling: "Delay"
    slopes: Array
    left_out: tuple[str, ...] = ()


class _StrangeLog(EvidenceError):
    """A log that does not show what the others show: `number` among them."""

    def __init__(self, text: str, number: int) -> None:
        super().__init__(text)
        self.number = number


@dataclass(frozen=True, eq=False)
class _CameraTracks:
    """What one log shows through one camera: its number among
    the logs, its tracks, its median picture, some images.
    """

    log: Path
    number: int
    tracks: "CornerTracks"
    picture: Array | None
    keys: "KeyFrames"


def calibrate_cameras(
    logs: Sequence[tuple[Path, Recording]],
    settings: "Settings",
    leave_out: bool = False,
    joints: Sequence[str] | None = None,
) -> Iterator[SurfaceCalibration | EvidenceError]:
    """Yield each camera's calibration from all logs of one robot together, or why it fails.

    The logs have one camera, lens, row time and zeros; each has a delay. `leave_out`: logs that do
    not show what the others show are left out. joints: those that move, and their order; None for
    all that do. ModelError where no joint of the URDF is in a log, EvidenceError where no joint
    moves.
    """
    import numpy as np

    from ..robot.model import named_robot

    first, read = logs[0]
    robot = named_robot(first, settings)
    joint_of, motions, still = find_moving_urdf_joints(logs, robot, joints)
    hints = camera_hints(first, robot, read, settings)
    for name in dict.fromkeys(name for _, one in logs for name in _frames_by_camera(one)):
        left_out = list[str]()
        try:
            films = list(_track_each_log(logs, name, left_out if leave_out else None))
            while True:
                try:
                    fit, seen, moving = _calibrate_camera(
                        name, films, robot, motions, joint_of, still, hints.get(name), settings
                    )
                except _StrangeLog as problem:
                    if not leave_out or len(films) == 1:
                        raise
                    left_out.append(str(problem))
                    del films[problem.number]
                else:
                    break
            mapped = build_map(fit, seen, [one.keys for one in films])
        except EvidenceError as problem:
            yield problem
            continue
        from ..estimation.timing.delay_profile import Delay
        from ..kinematics.landmark_errors import unknowns_covariance

        rest = {joint: still[joint] for joint in robot.by_name if joint in still}
        seen_by = tuple(film.log for film in films)
        size = films[0].tracks.size
        picture = films[-1].picture
        by_tracks = unknowns_covariance(fit)
        std = np.sqrt(np.diag(by_tracks))
        row = fit.model.of_row_time
        rolling = Delay(float(fit.phi[row]), float(std[row]))
        slopes = by_tracks[fit.model.of_delays, row] / std[row] ** 2
        delays = fit.phi[fit.model.of_delays]
        delay_std = std[fit.model.of_delays]
        used_share = len(fit.used) / moving
        fit, landmarks = (fit, None) if mapped is None else mapped
        covariance = unknowns_covariance(fit)
        yield SurfaceCalibration(
            name,
            seen_by,
            fit,
            covariance,
            moving,
            used_share,
            size,
            picture,
            joint_of,
            rest,
            delays,
            delay_std,
            landmarks,
            seen,
            rolling,
            slopes,
            tuple(left_out),
        )


def _frames_by_camera(read: Recording) -> dict[str, Callable[[], Iterator[LazyImage]]]:
    """The frames of each camera of a log, "" the first."""
    films = {"": read.cameras.frames, **read.cameras.views}
    return {name: film for name, film in films.items() if film is not None}


def camera_hints(
    log: Path, robot: "Robot", read: Recording, settings: "Settings"
) -> "dict[str, CameraHint]":
    """What a log says of its cameras' links, poses and lenses,
    by name, "" the first, of which [camera] tells too.
    """
    from ..kinematics.links import CameraHint
    from ..recording.robot_description import read_robot_description
    from ..robot.known_camera import with_known
    from ..robot.model import describe_logged_camera

    description = read_robot_description(log, settings.input)
    topics = {
        role.partition("/")[2]: path
        for role, path in read.facts.roles.items()
        if role.partition("/")[0] == "camera"
    }
    camera_hints = {
        name: describe_logged_camera(topic, description, robot) for name, topic in topics.items()
    }
    hints = {name: hint for name, hint in camera_hints.items() if hint is not None}
    return {**hints, "": with_known(hints.get("", CameraHint()), settings.camera, robot)}


def find_moving_urdf_joints(
    logs: Sequence[tuple[Path, Recording]], robot: "Robot", joints: Sequence[str] | None = None
) -> "tuple[dict[str, str], list[JointCurve], dict[str, float]]":
    """The joints that move in any log, with their names in
    the URDF, as curves of each log; the angles of the others.

    ModelError where the URDF has none of a log's joints, or
    logs have different ones; EvidenceError where none moves.
    """
    import numpy as np

    joint_of = dict[str, str]()
    columns = dict[str, Array]()
    for number, (log, read) in enumerate(logs):
        matched = _match_urdf_joints(log, read, robot)
        if number and matched != joint_of:
            differing = sorted({*matched.items()} ^ {*joint_of.items()})[0][0]
            raise ModelError(
                f"{log}: {logs[0][0]} has other joints: {differing!r} is in one of them alone"
            )
        joint_of = matched
        assert read.signals.joints is not None
        for name in joint_of:
            values = read.signals.joints.values[:, list(read.signals.joints.names).index(name)]
            columns[name] = np.concatenate([columns.get(name, np.zeros(0)), values])
    ranges = {name: _robust_range(column) for name, column in columns.items()}
    still = {
        joint_of[name]: float(np.nanmedian(columns[name]))
        for name in joint_of
        if ranges[name] < LEAST_RANGE
    }
    moving = {name: joint for name, joint in joint_of.items() if ranges[name] >= LEAST_RANGE}
    if joints is not None:
        if lacking := [name for name in joints if name not in joint_of]:
            raise ModelError(f"{robot.source}: {lacking[0]!r} is not in it; leave the surface out")
        moving = {name: joint_of[name] for name in joints}
        still = {joint: at for joint, at in still.items() if joint not in moving.values()}
    if not moving:
        raise EvidenceError(
            f"{logs[0][0]}: none of its joints moves; the surface of a robot tells nothing then"
        )
    motions = [
        smoothed_motion(read.signals.joints, tuple(moving))
        for _, read in logs
        if read.signals.joints is not None
    ]
    return moving, motions, still


def _match_urdf_joints(log: Path, read: Recording, robot: "Robot") -> dict[str, str]:
    """The URDF's joint of each of a log's joints that it has."""
    from ..kinematics.joint_names import match_joints
    from ..kinematics.robot import MOVING

    if read.signals.joints is None:
        raise EvidenceError(f"{log}: no joint states in it; the surface of a robot needs them")
    known = [joint.name for joint in robot.joints if joint.kind in MOVING and joint.mimic is None]
    joint_of = match_joints(read.signals.joints.names, known)
    if not joint_of:
        names = ", ".join(read.signals.joints.names[:12])
        have = ", ".join(known[:12])
        raise ModelError(
            f"{robot.source}: none of the joints of {log} ({names}) is in it; it has {have}"
        )
    return joint_of


def _robust_range(column: Array) -> float:
    import numpy as np

    finite = column[np.isfinite(column)]
    return float(np.ptp(np.percentile(finite, [2.0, 98.0]))) if len(finite) > 1 else 0.0


def smoothed_motion(joints: Series, names: Sequence[str]) -> "JointCurve":
    """The joints' angles as curves: integrated-Wiener smoothing, noise and motion by evidence."""
    import numpy as np

    from ..body.data import angle_smoother
    from ..kinematics.joint_motion import curve_error, curve_through_samples

    grid = np.arange(joints.t[0], joints.t[-1], _GRID_S)
    columns = []
    noise = np.empty((3, len(names)))
    for joint, name in enumerate(names):
        readings = joints.values[:, list(joints.names).index(name)]
        finite = np.isfinite(readings)
        signal = angle_smoother.build_reading_chain(joints.t[finite], readings[finite])
        motion = angle_smoother.fit_white_motion([signal], 3, with_errors=False)
        # a joint's own readings may begin later and end earlier than those of other topics
        within = np.clip(grid, signal.t[0], signal.t[-1])
        columns.append(angle_smoother.smooth_angles(signal, motion, within)[0])
        every_s = (signal.t[-1] - signal.t[0]) / (signal.count.sum() - 1.0)
        noise[:, joint] = motion.encoder, motion.process, every_s
    return curve_through_samples(grid, np.stack(columns, axis=1), curve_error(*noise))


def _track_each_log(
    logs: Sequence[tuple[Path, Recording]], camera: str, left_out: list[str] | None
) -> Iterator[_CameraTracks]:
    """Yield what each log shows through a camera; EvidenceError where too little moves or images
    differ in size: of one log a text in `left_out`, unless that is None.
    """
    problems = list[EvidenceError]()
    size: tuple[int, int] | None = None
    for number, (log, read) in enumerate(logs):
        film = _frames_by_camera(read).get(camera)
        if film is None:
            continue
        try:
            where = f"{log}: {camera or 'camera'}"
            tracks, picture, keys = _moving_tracks(where, film, len(logs))
            size = size or tracks.size
            _require_size(where, tracks.size, size)
        except EvidenceError as problem:
            if left_out is None:
                raise
            problems.append(problem)
            left_out.append(str(problem))
            continue
        yield _CameraTracks(log, number, tracks, picture, keys)
    if size is None:
        raise problems[0]


def _require_size(where: str, size: tuple[int, int], first: tuple[int, int]) -> None:
    """EvidenceError for images of another size than the first log's."""
    if size != first:
        found, expected = ("x".join(map(str, one)) for one in (size, first))
        raise EvidenceError(
            f"{where}: images of {found} px, of {expected} px in the first log; fit them apart"
        )


def camera_film(log: Path, read: Recording, camera: str) -> Callable[[], Iterator[LazyImage]]:
    """The frames of a camera, "camera" the first. EvidenceError without it."""
    film = _frames_by_camera(read).get("" if camera == "camera" else camera)
    if film is None:
        raise EvidenceError(f"{log}: {camera}: no images of it in this log")
    return film


def track_camera(
    log: Path, read: Recording, camera: str
) -> "tuple[CornerTracks, Array | None, KeyFrames]":
    """The corners that move before a camera, "camera"
    the first, its median picture, grey and shrunken, and some images.

    EvidenceError without the camera, or where too little moves.
    """
    return _moving_tracks(f"{log}: {camera}", camera_film(log, read, camera), 1)


def _moving_tracks(
    where: str, film: Callable[[], Iterator[LazyImage]], logs: int
) -> "tuple[CornerTracks, Array | None, KeyFrames]":
    from ..kinematics.landmark_fit import LEAST_PIECES
    from ..perception.surface.corner_tracks import MOST_KEY_FRAMES, moving_pieces, track_corners

    most_keys = min(MOST_KEY_FRAMES, max(_MOST_KEPT_FRAMES // logs, _LEAST_KEPT_FRAMES))
    tracks, survey, keys = track_corners(film, most_key_frames=most_keys)
    moving = moving_pieces(tracks)
    if len(moving) < LEAST_PIECES:
        raise EvidenceError(
            f"{where}: {len(moving)} corners move in its images; the surface needs {LEAST_PIECES}"
        )
    return tracks.take(moving), survey.median, keys


def _calibrate_camera(
    name: str,
    films: Sequence[_CameraTracks],
    robot: "Robot",
    motions: "Sequence[JointCurve]",
    joint_of: Mapping[str, str],
    still: Mapping[str, float],
    hint: "CameraHint | None",
    settings: "Settings",
) -> "tuple[LandmarkFit, LandmarkSightings, int]":
    """The fit of one camera, all moving pieces, and how many
    it was tried on; EvidenceError where no arm is seen.
    """
    from math import radians

    from ..kinematics.landmark_fit import build_model, choose_pieces
    from ..kinematics.landmarks import join_landmark_tracks
    from ..kinematics.links import CameraHint, Space

    zero_std = radians(settings.kinematics.offset_prior)
    space = Space(robot, tuple(joint_of.values()), dict(still), zero_std)
    size = films[0].tracks.size
    hint = replace(hint or CameraHint(), size=size)
    seen = join_landmark_tracks(
        [(one.tracks.piece, one.tracks.t[one.tracks.frame], one.tracks.uv) for one in films],
        size[1],
    )
    part = seen.take(choose_pieces(seen, _most_pieces(len(films)))).thinned(ROW_STRIDE)
    few = seen.take(choose_pieces(seen, -(-SEARCH_PIECES // len(films)))).thinned(SEARCH_STRIDE)
    own_motions = [motions[one.number] for one in films]
    placements = number_placements([one.picture for one in films], size[0])
    best: LandmarkFit | None = None
    for cameras in _start_cameras(name or "camera", robot, space, hint):
        model = build_model(space, cameras[0], own_motions, zero_std)
        model = replace(model, placements=placements)
        for found in _iterate_fits(model, cameras, few, part):
            if best is None or len(found.used) > len(best.used):
                best = found
        if best is not None and len(best.used) >= _LEAST_SHARE * part.count:
            break
    where = f"{films[0].log}: {name or 'camera'}"
    if best is None or len(best.used) < _LEAST_SHARE * part.count:
        count = 0 if best is None else len(best.used)
        raise EvidenceError(
            f"{where}: the joints explain {count} of {part.count} moving corners; no arm is seen"
            + suggest_camera_place(name, hint)
        )
    _require_belonging(name, films, best, part)
    return best, seen, part.count


def suggest_camera_place(name: str, hint: "CameraHint") -> str:
    """What helps to find an arm before a camera, "" the first, of which no place is known; nothing
    where one is known.
    """
    if hint.pose is not None:
        return ""
    how = "a transform to its frame in the log" if name else "[camera] link and place in robot.toml"
    return f"; if one is in view, {how} may find it"


def number_placements(pictures: Sequence[Array | None], width: int) -> tuple[int, ...]:
    """Of each log, by its picture (h,w), the number of its camera's placement, 0 that of the last
    log: another one where the still scene lies elsewhere in images `width` px wide; empty where it
    does in none. Pictures of different scenes tell nothing.
    """
    shown = [pictures[-1]]
    found = list[int]()
    for picture in reversed(pictures):
        shifts = [
            None if known is None else picture_shift(known, picture, width) for known in shown
        ]
        near = [
            k for k, shift in enumerate(shifts) if shift is not None and shift < SAME_PICTURE_PX
        ]
        if not near and any(shift is not None for shift in shifts):
            near = [len(shown)]
            shown.append(picture)
        found.append(near[0] if near else 0)
    return tuple(reversed(found)) if any(found) else ()


def picture_shift(before: Array, after: Array | None, width: int) -> float | None:
    """How far (px of images `width` px wide) the still scene
    moved between two pictures; None for different scenes.
    """
    import cv2
    import numpy as np

    if after is None or before.shape != after.shape:
        return None
    first, second = (
        cv2.GaussianBlur(one.astype(np.float32), (0, 0), _BLUR_PX) for one in (before, after)
    )
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    try:
        correlation, warp = cv2.findTransformECC(
            first, second, np.eye(2, 3, dtype=np.float32), cv2.MOTION_TRANSLATION, criteria
        )
    except cv2.error:  # it does not converge: no picture of one scene
        return None
    return (
        float(np.hypot(*warp[:, 2])) * width / before.shape[1]
        if correlation > _LEAST_ALIKE
        else None
    )


def explains_enough_pieces(fit: "LandmarkFit", part: "LandmarkSightings") -> bool:
    """Whether a fit explains enough of the pieces that it was tried on."""
    return len(fit.used) >= _LEAST_SHARE * part.count


def _most_pieces(logs: int) -> int:
    """Pieces of each log that are used: of many logs
    fewer each, since together they tell enough.
    """
    from ..kinematics.landmark_fit import MOST_PIECES

    return MOST_PIECES if logs == 1 else MOST_PIECES // 2


def _require_belonging(
    name: str, films: Sequence[_CameraTracks], best: "LandmarkFit", part: "LandmarkSightings"
) -> None:
    """EvidenceError where the joints of another time explain
    a log's corners as well, or they explain few of them.
    """
    import numpy as np

    used = np.bincount(part.log[part.begins][best.used], minlength=len(films))
    count = np.bincount(part.log[part.begins], minlength=len(films))
    control = control_counts(best, part)
    for number, film in enumerate(films):
        where = f"{film.log}: {name or 'camera'}"
        if used[number] < _LEAST_SHARE_OF_ONE * count[number]:
            text = (
                f"the joints explain {used[number]} of {count[number]} moving corners; no arm is "
                "seen"
            )
            others = ", though other logs show one" if len(films) > 1 else ""
            raise _StrangeLog(f"{where}: {text}{others}", number)
        if control[number] > _CONTROL_RATIO * used[number]:
            shares = f"{control[number]} against {used[number]}"
            text = f"the joints of another time explain the corners as well ({shares})"
            text += "; the images do not belong to the joints"
            raise _StrangeLog(f"{where}: {text}", number)


def _start_cameras(
    name: str, robot: "Robot", space: object, hint: "CameraHint"
) -> "Iterator[list[RigCamera]]":
    """Yield sets of cameras to start from, all on one link:
    as the log places it, on named links, around the arm.
    """
    import numpy as np

    from ..kinematics.landmark_starts import (
        around_the_arm,
        camera_links,
        free_camera,
        nominal_camera,
    )
    from ..kinematics.links import hinted_camera

    if hint.link is not None:
        yield [hinted_camera(name, hint.link, hint, robot)]
    for link in camera_links(robot)[:2]:
        yield [nominal_camera(name, link, hint, robot)]
    yield list(around_the_arm(free_camera(name, hint, robot), np.array([0.0, 0.0, 0.3])))


def _iterate_fits(
    model: "LandmarkModel",
    cameras: "Sequence[RigCamera]",
    few: "LandmarkSightings",
    part: "LandmarkSightings",
) -> "Iterator[LandmarkFit]":
    from ..kinematics.landmark_fit import staged_fit
    from ..kinematics.landmark_starts import best_starts

    for start, phi, _ in best_starts(model, few, cameras):
        found = staged_fit(start, phi, part, wide=len(cameras) > 1)
        if found is not None:
            yield found


def control_counts(best: "LandmarkFit", part: "LandmarkSightings") -> Array:
    """Pieces of each log that the joints of another time
    explain: those of half the log later, in a circle.
    """
    import numpy as np

    from ..kinematics.landmark_fit import choose_pieces, staged_fit

    logs = len(best.model.motions)
    motions = tuple(shifted_motion(motion) for motion in best.model.motions)
    model = replace(best.model, motions=motions)
    few = part.take(choose_pieces(part, _CONTROL_PIECES))
    found = staged_fit(model, best.phi, few)
    if found is None:
        return np.zeros(logs, int)
    tried, count = (np.bincount(one.log[one.begins], minlength=logs) for one in (few, part))
    explained = np.bincount(few.log[few.begins][found.used], minlength=logs)
    return np.asarray(np.round(explained * count / np.maximum(tried, 1)).astype(int))


def shifted_motion(motion: "JointCurve") -> "JointCurve":
    """The motion half its length later, in a circle."""
    import numpy as np

    from ..kinematics.joint_motion import curve_through_samples

    return curve_through_samples(motion.t, np.roll(motion.q, len(motion.t) // 2, axis=0))
