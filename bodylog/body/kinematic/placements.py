"""Where a body learned with a URDF has its cameras and markers, their lenses, and the joints' zeros and scales."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel, Surface
from ...kinematics import identifiability
from ...kinematics.identifiability import Offset
from ...kinematics.rig import Rig
from ...kinematics.rotations import inverse, logarithm
from ...logs.tables.frame_columns import frame_of
from ...types import Array, Finding
from .model import kinematic_senses

WORST_PLACE_M = 0.1
"""Largest std of a place that is identifiable: a third of the prior of a marker's place, 0.3 m."""
WORST_TURN_RAD = float(np.radians(10.0))
"""Largest std of an orientation that is identifiable."""
IMAGE_SIZES = "image_sizes"
"""In the provenance: {camera: [width, height]} px."""
EARLIER = "earlier_placements"
"""In the provenance: the placements before cameras and markers moved between logs, as Placement.plain."""
_STEP = 1e-6
_POSE = 6
"""Unknowns of a camera's pose; its lens follows."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A frame in a link: pose (4,4) m · place_std (3,) m along the link's axes · turn_std (3,) rad about them.

    turns: whether the orientation is known at all; a marker of one point has none.
    """

    name: str
    link: str
    pose: Array
    place_std: Array
    turn_std: Array
    turns: bool = True

    @property
    def identifiable(self) -> bool:
        """Whether the sightings, or what was known before them, determine it."""
        placed = bool((self.place_std <= WORST_PLACE_M).all())
        return placed and (not self.turns or bool((self.turn_std <= WORST_TURN_RAD).all()))

    @property
    def plain(self) -> dict[str, Any]:
        """The placement as plain values; `placement_from` reads them."""
        return {
            "name": self.name,
            "link": self.link,
            "pose": self.pose.tolist(),
            "place_std": self.place_std.tolist(),
            "turn_std": self.turn_std.tolist(),
            "turns": self.turns,
        }


def placement_from(plain: Mapping[str, Any]) -> Placement:
    """A placement from its plain values."""
    pose, place_std, turn_std = (np.array(plain[name], float) for name in ("pose", "place_std", "turn_std"))
    return Placement(plain["name"], plain["link"], pose, place_std, turn_std, plain["turns"])


@dataclass(frozen=True, eq=False)
class Lens:
    """A lens: focal lengths (2,) px, centre (2,) px and radial distortion k1, k2 (2,), each with its std.

    row_time: s from the first to the last row of an image, None where it was not estimated.
    """

    focal: Array
    focal_std: Array
    centre: Array
    centre_std: Array
    distortion: Array
    distortion_std: Array
    row_time: float | None = None
    row_time_std: float | None = None


@dataclass(frozen=True, eq=False)
class Calibration:
    """All unknowns of a body learned with a URDF; the findings say what is not identifiable.

    image_sizes: (width, height) px by camera, where they are known · earlier: where cameras and markers were before
    they moved between logs.

    Poses hold together with the zeros as given, those that are not identifiable at 0.
    """

    cameras: tuple[Placement, ...]
    lenses: tuple[Lens, ...]
    markers: tuple[Placement, ...]
    zeros: tuple[Offset, ...]
    scales: tuple[Offset, ...]
    findings: tuple[Finding, ...]
    image_sizes: Mapping[str, tuple[int, int]]
    earlier: tuple[Placement, ...] = ()


CALIBRATION = "a calibration"
"""What a body without a URDF lacks."""


def calibration(model: BodyModel) -> Calibration:
    """The calibration of a body; ModelError where it was learned without a URDF."""
    if model.surface is not None:
        return _of_surface(model.surface)
    senses = list(kinematic_senses(model, CALIBRATION).values())
    first = senses[0]
    covariance = first.root @ first.root.T
    every_zero = identifiability.offsets(first.rig, first.theta, covariance)
    zeros = tuple(one for one in every_zero if one.beforehand > identifiability.GIVEN)
    scales = identifiability.scales(first.rig, first.theta, covariance)
    cameras, lenses, markers = dict[str, Placement](), dict[str, Lens](), dict[str, Placement]()
    for sense in senses:
        rig = sense.rig
        camera, marker = rig.cameras[0].name, rig.carriers[0].name
        if camera in cameras and marker in markers:
            continue
        theta, spread = _given_zeros(rig, sense.theta, sense.root @ sense.root.T, (*every_zero, *scales))
        cameras.setdefault(camera, _camera(rig, theta, spread))
        lenses.setdefault(camera, _lens(rig, theta, spread))
        markers.setdefault(marker, _marker(rig, theta, spread))
    unmeasured = [_without_row_time(one) for one in cameras.values()]
    findings = [*unmeasured, *_findings(tuple(cameras.values()), tuple(markers.values()), (*zeros, *scales))]
    if not zeros:
        findings.append(_without_zeros(first.rig.joints))
    return Calibration(
        tuple(cameras.values()),
        tuple(lenses.values()),
        tuple(markers.values()),
        zeros,
        scales,
        tuple(findings),
        {name: (int(size[0]), int(size[1])) for name, size in model.provenance.get(IMAGE_SIZES, {}).items()},
        tuple(placement_from(plain) for plain in model.provenance.get(EARLIER, ())),
    )


def earlier_placements(rig: Rig, theta: Array, covariance: Array, known: Sequence[Offset]) -> list[Placement]:
    """Where cameras and markers were before they moved between logs; known: zeros and scales, as for `_given_zeros`."""
    found = dict[tuple[bool, int], Placement]()
    for k, sight in enumerate(rig.sights):
        for log, pair in enumerate(sight.by_log):
            for camera, index, now in ((True, pair[0], sight.camera), (False, pair[1], sight.carrier)):
                if index == now or (camera, index) in found:
                    continue
                sub, used = rig.alone(k, log)
                given, spread = _given_zeros(sub, theta[used], covariance[np.ix_(used, used)], known)
                placed = _camera(sub, given, spread) if camera else _marker(sub, given, spread)
                logs = [number + 1 for number, other in enumerate(sight.by_log) if other[not camera] == index]
                when = f"log {logs[0]}" if len(logs) == 1 else f"logs {logs[0]} to {logs[-1]}"
                found[camera, index] = replace(placed, name=f"{placed.name} in {when}")
    return list(found.values())


def _of_surface(surface: Surface) -> Calibration:
    """The calibration by the robot's own surface; zeros are those that the first camera tells."""
    from ..surface import landmark_model

    cameras, lenses = list[Placement](), list[Lens]()
    zeros: tuple[Offset, ...] = ()
    for camera in surface.cameras:
        rig = landmark_model(surface, camera).rig
        theta, spread = camera.unknowns[:-1], camera.covariance[:-1, :-1]
        every_zero = identifiability.offsets(rig, theta, spread)
        zeros = zeros or tuple(one for one in every_zero if one.beforehand > identifiability.GIVEN)
        given, held = _given_zeros(rig, theta, spread, every_zero)
        cameras.append(_camera(rig, given, held))
        row, row_std = float(camera.unknowns[-1]), float(np.sqrt(camera.covariance[-1, -1]))
        lenses.append(replace(_lens(rig, given, held), row_time=row, row_time_std=row_std))
    findings = tuple(_findings(cameras, (), zeros))
    sizes = {placed.name: camera.size for placed, camera in zip(cameras, surface.cameras, strict=True)}
    return Calibration(tuple(cameras), tuple(lenses), (), zeros, (), findings, sizes)


def _without_row_time(camera: Placement) -> Finding:
    return Finding("info", f"{camera.name}: the time from one row of an image to the next is not estimated")


def _without_zeros(joints: tuple[str, ...]) -> Finding:
    """Why a body has no zeros at all."""
    frame = frame_of(joints)
    if frame is None:
        return Finding("info", "no joint's zero was estimated: [kinematics] offset_prior is 0")
    return Finding("info", f"poses of {frame} alone do not tell the joints' zeros; learn from joints with --urdf")


def _given_zeros(rig: Rig, theta: Array, covariance: Array, known: Sequence[Offset]) -> tuple[Array, Array]:
    """θ (P,) with the zeros and scales as given, and its covariance (P,P) with those not identifiable held at 0.

    A camera's turn that a joint's zero imitates has no meaning until that zero is agreed upon.
    """
    std = rig.prior[1]
    scaled = covariance / std / std[:, None]
    rows = np.arange(rig.of_joints.start, rig.of_scales.stop)
    given = np.array([one.value if one.identifiable else 0.0 for one in known])
    step = np.linalg.lstsq(scaled[np.ix_(rows, rows)], (given - theta[rows]) / std[rows], rcond=None)[0]
    held = rows[[not one.identifiable for one in known]]
    gain = np.linalg.lstsq(scaled[np.ix_(held, held)], scaled[held], rcond=None)[0]
    return theta + std * (scaled[:, rows] @ step), (scaled - scaled[:, held] @ gain) * std * std[:, None]


def _camera(rig: Rig, theta: Array, covariance: Array) -> Placement:
    """The camera's optical frame in its link: x to the right of the image, y down, z forward."""
    part = rig.of_camera(0)
    return _placement(rig, theta, covariance, slice(part.start, part.start + _POSE), camera=True)


def _marker(rig: Rig, theta: Array, covariance: Array) -> Placement:
    return _placement(rig, theta, covariance, rig.of_carrier(0), camera=False)


def _placement(rig: Rig, theta: Array, covariance: Array, part: slice, camera: bool) -> Placement:
    """A thing's pose on its link, with the covariance of θ (P,P) propagated by central differences."""

    def pose(at: Array) -> Array:
        return inverse(rig.camera_pose(0, at)) if camera else rig.carrier_pose(0, at)

    slopes = np.zeros((_POSE, part.stop - part.start))
    for k, index in enumerate(range(part.start, part.stop)):
        step = np.zeros(len(theta))
        step[index] = _STEP
        above, below = pose(theta + step), pose(theta - step)
        slopes[:3, k] = (above[:3, 3] - below[:3, 3]) / (2.0 * _STEP)
        slopes[3:, k] = logarithm(above[:3, :3] @ below[:3, :3].T) / (2.0 * _STEP)
    variance = np.einsum("ij,jk,ik->i", slopes, covariance[part, part], slopes)
    std = np.sqrt(np.maximum(variance, 0.0))
    thing = rig.cameras[0] if camera else rig.carriers[0]
    turns = camera or rig.carriers[0].turns
    return Placement(thing.name, thing.link, pose(theta), std[:3], std[3:], turns)


def _lens(rig: Rig, theta: Array, covariance: Array) -> Lens:
    part = rig.of_camera(0)
    begin = part.start + _POSE
    numbers = theta[begin : part.stop]
    spread = covariance[begin : part.stop, begin : part.stop]
    std = np.sqrt(np.maximum(np.diag(spread), 0.0))
    across = float(np.exp(numbers[0]))
    focal = np.array([across, across * np.exp(numbers[1])])
    ratio_std = np.sqrt(max(float(spread[:2, :2].sum()), 0.0))
    focal_std = focal * np.array([std[0], ratio_std])
    return Lens(focal, focal_std, numbers[2:4], std[2:4], numbers[4:], std[4:])


def _findings(cameras: Sequence[Placement], markers: Sequence[Placement], zeros: Sequence[Offset]) -> Iterator[Finding]:
    """Yield a sentence for each thing that is not identifiable."""
    for one in (*cameras, *markers):
        if not one.identifiable:
            place = f"its place on {one.link} is known to {1e3 * one.place_std.max():.0f} mm"
            turn = f", its turn to {np.degrees(one.turn_std.max()):.0f}°" if one.turns else ""
            yield Finding("warning", f"{one.name}: not identifiable: {place}{turn} alone")
    for text in identifiability.unidentified(zeros):
        yield Finding("info", f"{text}; the poses hold with it at 0")
