"""Find the links of the camera and the marker:
from the log, or by evidence over the URDF's links.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import ModelError
from ..types import Array
from .calibration import Calibrated, Sighted, calibrate_rig, scout_start
from .camera import lens_without_distortion
from .chain import Chain, chain_between
from .rig import Carrier, Rig, RigCamera, Sight
from .robot import MOVING, Robot, is_optical
from .rotations import invert_transform
from .starts import find_starts

ANYWHERE = 10.0
"""m and rad: prior std of an unknown pose."""
MARKER = 0.3
"""m: prior std of a point's position in its link, the size of what an arm carries."""
FREE_LENS = np.array([0.4, 0.02, 30.0, 30.0, 0.2, 0.2])
"""Prior std of a lens known by its image size: fields of view from 35° to 80°, small distortion."""
INFO_LENS = np.array([0.01, 0.002, 5.0, 5.0, 0.02, 0.02])
"""Prior std of a lens from CameraInfo: a percent
of the focal length, a few pixels of the centre.
"""
FRAME_POSE = np.array([0.02] * 3 + [np.radians(6.0)] * 3)
"""m, rad: prior std of a camera whose optical frame is in the URDF."""
TF_POSE = np.array([0.02] * 3 + [np.radians(2.0)] * 3)
"""m, rad: prior std of a camera placed by a transform in the log."""
MOST_PAIRS = 4096
"""Pairs of links that are compared, each by a short descent; a humanoid of 43 joints has 1936."""
_FEW = 60
_PROMISING = 3


@dataclass(frozen=True, eq=False)
class CameraHint:
    """A camera by the log: its link or None · pose (4,4)
    of camera in link, m, or None · lens (6,) or None.

    size: of its images, (width, height) px, or None · extent: a likely
    size where it is not known · lens_std, pose_std (6,): prior std of
    a lens and a pose that somebody gave; else INFO_LENS and TF_POSE.
    """

    link: str | None = None
    pose: Array | None = None
    lens: Array | None = None
    size: tuple[int, int] | None = None
    extent: tuple[int, int] | None = None
    lens_std: Array | None = None
    pose_std: Array | None = None


@dataclass(frozen=True, eq=False)
class MarkerHint:
    """A marker as somebody knows it: its link or None · pose (4,4) in
    the link, m, or None · pose_std (6,): its prior std, m and rad.
    """

    link: str | None
    pose: Array | None
    pose_std: Array


@dataclass(frozen=True, eq=False)
class MarkerTrack:
    """Sightings of one marker in one camera or by one tracker, by
    name · points (C,3) m of a rigid board, or one at the origin.
    """

    camera: str
    marker: str
    data: Sighted
    points: Array = field(default_factory=lambda: np.zeros((1, 3)))


@dataclass(frozen=True, eq=False)
class FoundLinks:
    """The chosen rig, its calibration, and the nats it wins against the next alternative (or None).

    lacking: joints of the chains without readings, assumed at zero.
    """

    calibrated: Calibrated
    margin: float | None
    lacking: tuple[str, ...]


def find_links(
    robot: Robot,
    joints: Sequence[str],
    still: Mapping[str, float],
    tracks: Mapping[str, MarkerTrack],
    hints: Mapping[str, CameraHint],
    doubt: float,
    scale: float = 0.0,
    carried: Mapping[str, str] | None = None,
    things: Mapping[str, MarkerHint] | None = None,
) -> FoundLinks:
    """Find the most likely links of camera and marker
    for each track, then calibrate all tracks together.

    joints: names of the data's columns · still: angles of joints that did not move · doubt: prior
    std of joint zeros, rad · scale: prior std of joint scales; 0 keeps them at 1 · carried: links
    of markers where they are known · things: what is known of markers. Give the most reliable
    tracks first.
    """
    things = things or {}
    space = Space(robot, tuple(joints), still, doubt, scale, things)
    placed: dict[str, str] = {
        name: hint.link for name, hint in hints.items() if hint.link is not None
    }
    markers = {name: hint.link for name, hint in things.items() if hint.link is not None}
    markers |= carried or {}
    margin = None
    best = None
    for track in tracks.values():
        if track.camera in placed and track.marker in markers:
            continue
        best, least = _most_likely_links(
            space, track, placed.get(track.camera), markers.get(track.marker), hints
        )
        margin = least if margin is None or (least is not None and least < margin) else margin
        placed[track.camera] = best.rig.cameras[0].link
        markers[track.marker] = best.rig.carriers[0].link
    if len(tracks) > 1 or best is None:
        rig = space.rig(list(tracks.values()), placed, markers, hints)
        data = [one.data for one in tracks.values()]
        rig, first = find_starts(rig, data)
        best = calibrate_rig(rig, data, first)
    ways = [space.lacking(sight.chain.start, sight.chain.end) for sight in best.rig.sights]
    return FoundLinks(best, margin, tuple(dict.fromkeys(name for way in ways for name in way)))


def _most_likely_links(
    space: "Space",
    track: MarkerTrack,
    camera: str | None,
    marker: str | None,
    hints: Mapping[str, CameraHint],
) -> tuple[Calibrated, float | None]:
    """One track's calibration on its most likely links,
    chosen by few sightings, and the nats they win.
    """
    rows = np.unique(
        np.linspace(0, len(track.data.q) - 1, min(len(track.data.q), _FEW)).round().astype(int)
    )
    part = Sighted(track.data.q[rows], track.data.image[rows], track.data.variance[rows])
    few = replace(track, data=part)
    found = list[Calibrated]()
    for pairs in space.pairs(camera, marker):
        for a, b in _preselect_links(space, few, pairs, hints):
            rig, first = find_starts(
                space.rig([few], {few.camera: a}, {few.marker: b}, hints), [part]
            )
            found.append(calibrate_rig(rig, [part], first))
        found.sort(key=lambda one: -one.evidence)
        if found and _explains_motion(found[0], part):
            break
    if not found:
        raise ModelError(
            f"{space.robot.source}: no joint that moved lies between any two of its links"
        )
    margin = found[0].evidence - found[1].evidence if len(found) > 1 else None
    links = found[0].rig.cameras[0].link, found[0].rig.carriers[0].link
    rig, first = find_starts(
        space.rig([track], {track.camera: links[0]}, {track.marker: links[1]}, hints), [track.data]
    )
    return calibrate_rig(rig, [track.data], first), margin


def _preselect_links(
    space: "Space",
    track: MarkerTrack,
    pairs: Sequence[tuple[str, str]],
    hints: Mapping[str, CameraHint],
) -> list[tuple[str, str]]:
    """The few pairs of links with the least loss after a short descent from one start."""
    drawn = [(a, b) for a, b in pairs if is_optical(a)]
    rest = [(a, b) for a, b in pairs if not is_optical(a)]
    if len(rest) <= _PROMISING:
        return [*drawn, *rest]
    left = []
    for a, b in rest:
        rig, first = find_starts(
            space.rig([track], {track.camera: a}, {track.marker: b}, hints), [track.data]
        )
        left.append((scout_start(rig, [track.data], first[0]), a, b))
    return [*drawn, *((a, b) for _, a, b in sorted(left)[:_PROMISING])]


def _explains_motion(found: Calibrated, data: Sighted) -> bool:
    """Whether a calibration explains most of the sightings' motion."""
    return (
        found.noise[found.rig.kinds[0]] < (EXPLAINED * data.spread) ** 2
        and float(np.mean(found.weights[0][data.seen])) > 0.5
    )


EXPLAINED = 0.1
"""Largest residual std over the sightings' motion:
0.03 for a real NAO, a third or more for wrong links.
"""


@dataclass(frozen=True, eq=False)
class Space:
    """A robot's links, grouped: links without a moving joint between them are equivalent."""

    robot: Robot
    joints: tuple[str, ...]
    still: Mapping[str, float]
    doubt: float
    scale: float = 0.0
    things: Mapping[str, MarkerHint] = field(default_factory=dict)

    def chain(self, camera: str, marker: str) -> Chain:
        """The chain from the camera's link to the marker's,
        with joints fixed that did not move or have no readings.
        """
        found = chain_between(self.robot, camera, marker)
        held = {name: self.still.get(name, 0.0) for name in found.joints if name not in self.joints}
        return found.holding(held).over(self.joints)

    def lacking(self, camera: str, marker: str) -> list[str]:
        """Joints between two links without readings."""
        names = chain_between(self.robot, camera, marker).joints
        return [name for name in names if name not in self.joints and name not in self.still]

    def pairs(self, camera: str | None, marker: str | None) -> Iterator[list[tuple[str, str]]]:
        """Yield pairs of links for camera and marker: first
        those with most joints between them, then the others.

        ModelError where there are more than MOST_PAIRS.
        """
        groups = self.groups
        optical = [link for link in self.robot.links if is_optical(link)]
        cameras = [camera] if camera else [*optical, *groups]
        markers = [marker] if marker else groups
        if (count := len(cameras) * len(markers)) > MOST_PAIRS:
            what = (
                f"{count} pairs of links may carry camera and marker, as {len(groups) - 1} of "
                "its joints move"
            )
            asked = f"at most {MOST_PAIRS} are compared; name fewer [body] joints"
            raise ModelError(f"{self.robot.source}: {what}; {asked}")
        counted = [(len(set(self._between(a, b))), a, b) for a in cameras for b in markers]
        counted = [one for one in counted if one[0]]
        most = max((count for count, _, _ in counted), default=0)
        yield [(a, b) for count, a, b in counted if count == most]
        rest = [(a, b) for count, a, b in counted if count < most]
        if rest:
            yield rest

    @property
    def groups(self) -> list[str]:
        """The uppermost link of each group."""
        below = (self.robot.root, *(j.child for j in self.robot.joints if self._moves(j.name)))
        return list(below)

    def _moves(self, name: str) -> bool:
        joint = self.robot.by_name[self.robot.driven[name][0]]
        return joint.kind in MOVING and joint.name in self.joints

    def _between(self, a: str, b: str) -> list[str]:
        return [name for name in chain_between(self.robot, a, b).joints if name in self.joints]

    def rig(
        self,
        tracks: Sequence[MarkerTrack],
        placed: Mapping[str, str],
        markers: Mapping[str, str],
        hints: Mapping[str, CameraHint],
    ) -> Rig:
        """The rig of some tracks with their cameras and markers on given links."""
        names = list(dict.fromkeys(track.camera for track in tracks))
        space = {track.camera for track in tracks if track.data.image.shape[-1] == 3}
        cameras = tuple(
            (_hinted_tracker if name in space else hinted_camera)(
                name, placed[name], hints.get(name, CameraHint()), self.robot
            )
            for name in names
        )
        things = {track.marker: track for track in tracks}
        carriers = tuple(
            _make_carrier(name, markers[name], len(track.points) > 1, self.things.get(name))
            for name, track in things.items()
        )
        sights = tuple(
            Sight(
                f"{track.camera}/{track.marker}",
                names.index(track.camera),
                list(things).index(track.marker),
                self.chain(placed[track.camera], markers[track.marker]),
                track.points,
            )
            for track in tracks
        )
        scales = np.full(len(self.joints) if self.scale else 0, max(self.scale, 1e-9))
        return Rig(
            cameras,
            carriers,
            sights,
            self.joints,
            np.maximum(self.zero_std(self.joints), 1e-9),
            scales,
        )

    def zero_std(self, joints: Sequence[str]) -> Array:
        """Prior std (M,) of joints' zeros, rad or m."""
        return np.array([self.doubt * (_SLIDE if self._slides(name) else 1.0) for name in joints])

    def _slides(self, name: str) -> bool:
        return name in self.robot.by_name and self.robot.by_name[name].kind == "prismatic"


_SLIDE = 0.1
"""m per rad: prior std of a prismatic joint's zero over a revolute one's; 5° correspond to 9 mm."""


def hinted_camera(name: str, link: str, hint: CameraHint, robot: Robot) -> RigCamera:
    """The camera on a link, by what the log says of its pose and lens, and how sure that is."""
    width, height = hint.size or hint.extent or (640, 480)
    numbers, known = (
        (lens_without_distortion(width, width, height), FREE_LENS)
        if hint.lens is None
        else (hint.lens, INFO_LENS)
    )
    if hint.lens_std is not None:
        known = hint.lens_std
    anchor, doubt = _hinted_pose(link, hint)
    given = hint.lens is not None and hint.lens_std is None
    known = known if given else scale_lens_std(known, width)
    return RigCamera(
        f"camera {name}".strip(), link, anchor, numbers, np.concatenate([doubt, known])
    )


def scale_lens_std(std: Array, width: float) -> Array:
    """A lens' prior std (6,) for images of this width, px; FREE_LENS is for 640 px."""
    return np.asarray(std * np.array([1.0, 1.0, width / 640, width / 640, 1.0, 1.0]))


def _hinted_tracker(name: str, link: str, hint: CameraHint, robot: Robot) -> RigCamera:
    """The tracker on a link, by what is known of its pose."""
    anchor, doubt = _hinted_pose(link, hint)
    return RigCamera(name, link, anchor, np.zeros(0), doubt)


def _hinted_pose(link: str, hint: CameraHint) -> tuple[Array, Array]:
    """The link in a camera (4,4) and the prior std (6,) of its pose."""
    if hint.link == link and hint.pose is not None:
        return invert_transform(hint.pose), TF_POSE if hint.pose_std is None else hint.pose_std
    if is_optical(link):
        return np.eye(4), FRAME_POSE
    return np.eye(4), np.full(6, ANYWHERE)


def _make_carrier(name: str, link: str, rigid: bool, hint: MarkerHint | None) -> Carrier:
    unknowns = 6 if rigid else 3
    if hint is not None and hint.pose is not None and hint.link == link:
        return Carrier(name, link, hint.pose, hint.pose_std[:unknowns])
    return Carrier(name, link, np.eye(4), np.full(6, ANYWHERE) if rigid else np.full(3, MARKER))
