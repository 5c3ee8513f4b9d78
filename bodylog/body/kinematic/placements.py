"""Where a body learned with a URDF has its cameras and
markers, their lenses, and the joints' zeros and scales.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ...body_model import BodyModel, Surface
from ...errors import ModelError
from ...kinematics import identifiability
from ...kinematics.adjustment import Adjusted
from ...kinematics.identifiability import Offset
from ...kinematics.rig import Rig
from ...kinematics.rotations import invert_transform, vector_from_rotation
from ...logs.tables.frame_columns import frame_of
from ...types import Array, Finding
from .model import kinematic_senses

WORST_PLACE_M = 0.1
"""Largest std of a place that is identifiable: a third of the prior of a marker's place, 0.3 m."""
WORST_TURN_RAD = float(np.radians(10.0))
"""Largest std of an orientation that is identifiable."""
IMAGE_SIZES = "image_sizes"
SAG = "sag"
"""Name in a body's provenance of a sentence about gravity sag, where its URDF has masses."""
"""In the provenance: {camera: [width, height]} px."""
KEPT = "calibration"
"""In the provenance: the calibration, as `kept_calibration` makes it plain."""
LENS_PARTS = ("focal", "focal_std", "centre", "centre_std", "distortion", "distortion_std")
_STEP = 1e-6
_POSE = 6
"""Unknowns of a camera's pose; its lens follows."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A frame in a link: pose (4,4) m · place_std (3,) m
    along the link's axes · turn_std (3,) rad about them.

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
    pose, place_std, turn_std = (
        np.array(plain[name], float) for name in ("pose", "place_std", "turn_std")
    )
    return Placement(plain["name"], plain["link"], pose, place_std, turn_std, plain["turns"])


@dataclass(frozen=True, eq=False)
class Lens:
    """A lens: focal lengths (2,) px, centre (2,) px and
    radial distortion k1, k2 (2,), each with its std.

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

    image_sizes: (width, height) px by camera, where they are known · earlier: where cameras and
    markers were before they moved between logs · trackers: the frames of points in space.

    compliances: of joints that give way to gravity · sag: a sentence about it.

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
    trackers: tuple[Placement, ...] = ()
    compliances: tuple[Offset, ...] = ()
    sag: str = ""


CALIBRATION = "a calibration"
"""What a body without a URDF lacks."""


def calibration_of_body(model: BodyModel) -> Calibration:
    """The calibration of a body; ModelError where it was
    learned without a URDF, or before calibrations were kept.
    """
    if model.surface is not None:
        return _of_surface(model.surface)
    kinematic_senses(model, CALIBRATION)
    kept = model.provenance.get(KEPT)
    if kept is None:
        todo = "learn it again; type: bodylog fit LOG --urdf ROBOT.urdf"
        raise ModelError(f"learned by an earlier version, which kept no calibration: {todo}")
    zeros, scales = (tuple(_offset_from(one) for one in kept[part]) for part in ("zeros", "scales"))
    cameras, markers, earlier, trackers = (
        tuple(placement_from(one) for one in kept.get(part, ()))
        for part in ("cameras", "markers", "earlier", "trackers")
    )
    lenses = tuple(_lens_from(one) for one in kept["lenses"])
    sagging = tuple(_offset_from(one) for one in kept.get("compliances", ()))
    findings = [
        *map(_without_row_time, cameras),
        *_unidentified_findings((*cameras, *trackers), markers, (*zeros, *scales, *sagging)),
    ]
    if not zeros:
        findings.append(_without_zeros(model.joints))
    sizes = {f"camera {name}".strip(): size for name, size in image_sizes(model).items()}
    return Calibration(
        cameras,
        lenses,
        markers,
        zeros,
        scales,
        tuple(findings),
        sizes,
        earlier,
        trackers,
        sagging,
        model.provenance.get(SAG, ""),
    )


def image_sizes(model: BodyModel) -> dict[str, tuple[int, int]]:
    """(width, height) px of a body's images by camera, "" the first; those that are known."""
    return {
        name.removeprefix("camera").strip(): (int(size[0]), int(size[1]))
        for name, size in model.provenance.get(IMAGE_SIZES, {}).items()
    }


def _zeros_and_scales(found: Adjusted) -> tuple[Offset, ...]:
    return (
        *identifiability.joint_zeros(found.rig, found.theta, found.covariance),
        *identifiability.joint_scales(found.rig, found.theta, found.covariance),
    )


def printed_unknowns(found: Adjusted) -> Array:
    """θ (P,) with the zeros as given."""
    known = _zeros_and_scales(found)
    return _given_zeros(found.rig, found.theta, found.covariance, known, found.curvature)[0]


def calibration_of(found: Adjusted) -> Calibration:
    """The calibration of an adjustment; poses and lenses hold with the zeros as given."""
    known = _zeros_and_scales(found)
    whole, spread = _given_zeros(found.rig, found.theta, found.covariance, known, found.curvature)
    given = replace(found, theta=whole, covariance=spread)
    cameras = dict[str, Placement]()
    lenses = dict[str, Lens]()
    markers = dict[str, Placement]()
    trackers = dict[str, Placement]()
    for k in range(len(given.rig.sights)):
        rig, used = given.rig.alone(k)
        camera = rig.cameras[0].name
        marker = rig.carriers[0].name
        theta = given.theta[used]
        covariance = given.covariance[np.ix_(used, used)]
        if rig.cameras[0].tracks_space:
            trackers.setdefault(camera, _camera_placement(rig, theta, covariance))
        else:
            cameras.setdefault(camera, _camera_placement(rig, theta, covariance))
            lenses.setdefault(camera, _lens_with_std(rig, theta, covariance))
        markers.setdefault(marker, _marker_placement(rig, theta, covariance))
    estimated = [one for one in known if one.beforehand > identifiability.GIVEN]
    return Calibration(
        tuple(cameras.values()),
        tuple(lenses.values()),
        tuple(markers.values()),
        tuple(one for one in estimated if one.noun == "zero"),
        tuple(one for one in estimated if one.noun == "scale"),
        (),
        {},
        tuple(_earlier_placements(given)),
        tuple(trackers.values()),
        identifiability.joint_compliances(given.rig, given.theta, found.covariance),
    )


def kept_calibration(found: Calibration) -> dict[str, Any]:
    """A calibration as plain values for a body's provenance; `calibration_of_body` reads them."""
    return {
        "cameras": [one.plain for one in found.cameras],
        "lenses": [
            {name: getattr(one, name).tolist() for name in LENS_PARTS} for one in found.lenses
        ],
        "markers": [one.plain for one in found.markers],
        "zeros": [asdict(one) | {"confused": list(one.confused)} for one in found.zeros],
        "scales": [asdict(one) | {"confused": list(one.confused)} for one in found.scales],
        "earlier": [one.plain for one in found.earlier],
        "trackers": [one.plain for one in found.trackers],
        "compliances": [
            asdict(one) | {"confused": list(one.confused)}
            for one in found.compliances
            if one.beforehand > identifiability.GIVEN
        ],
    }


def _offset_from(plain: Mapping[str, Any]) -> Offset:
    return Offset(**{**plain, "confused": tuple(plain["confused"])})


def _lens_from(plain: Mapping[str, Any]) -> Lens:
    focal, focal_std, centre, centre_std, distortion, distortion_std = (
        np.array(plain[name], float) for name in LENS_PARTS
    )
    return Lens(focal, focal_std, centre, centre_std, distortion, distortion_std)


def _earlier_placements(given: Adjusted) -> Iterator[Placement]:
    """Where cameras and markers were before they moved between logs."""
    rig = given.rig
    listed = set[tuple[bool, int]]()
    for k, sight in enumerate(rig.sights):
        for log, pair in enumerate(sight.by_log):
            for camera, index, now in (
                (True, pair[0], sight.camera),
                (False, pair[1], sight.carrier),
            ):
                if index == now or (camera, index) in listed:
                    continue
                listed.add((camera, index))
                sub, used = rig.alone(k, log)
                theta = given.theta[used]
                spread = given.covariance[np.ix_(used, used)]
                placed = (
                    _camera_placement(sub, theta, spread)
                    if camera
                    else _marker_placement(sub, theta, spread)
                )
                logs = [
                    number + 1
                    for number, other in enumerate(sight.by_log)
                    if other[not camera] == index
                ]
                when = f"log {logs[0]}" if len(logs) == 1 else f"logs {logs[0]} to {logs[-1]}"
                yield replace(placed, name=f"{placed.name} in {when}")


def _of_surface(surface: Surface) -> Calibration:
    """The calibration by the robot's own surface; zeros are those that the first camera tells."""
    from ..surface import landmark_model

    cameras = list[Placement]()
    lenses = list[Lens]()
    zeros: tuple[Offset, ...] = ()
    for camera in surface.cameras:
        rig = landmark_model(surface, camera).rig
        theta = camera.unknowns[:-1]
        spread = camera.covariance[:-1, :-1]
        every_zero = identifiability.joint_zeros(rig, theta, spread)
        zeros = zeros or tuple(one for one in every_zero if one.beforehand > identifiability.GIVEN)
        given, held = _given_zeros(rig, theta, spread, every_zero)
        cameras.append(_camera_placement(rig, given, held))
        row = float(camera.unknowns[-1])
        row_std = float(np.sqrt(camera.covariance[-1, -1]))
        lenses.append(replace(_lens_with_std(rig, given, held), row_time=row, row_time_std=row_std))
    findings = tuple(_unidentified_findings(cameras, (), zeros))
    sizes = {
        placed.name: camera.size for placed, camera in zip(cameras, surface.cameras, strict=True)
    }
    return Calibration(tuple(cameras), tuple(lenses), (), zeros, (), findings, sizes)


def _without_row_time(camera: Placement) -> Finding:
    return Finding(
        "info", f"{camera.name}: the time from one row of an image to the next is not estimated"
    )


def _without_zeros(joints: tuple[str, ...]) -> Finding:
    """Why a body has no zeros at all."""
    frame = frame_of(joints)
    if frame is None:
        return Finding("info", "no joint's zero was estimated: [kinematics] offset_prior is 0")
    return Finding(
        "warning",
        f"poses of {frame} alone do not tell the joints' zeros; learn from joints with --urdf",
    )


def _given_zeros(
    rig: Rig,
    theta: Array,
    covariance: Array,
    known: Sequence[Offset],
    curvature: Array | None = None,
) -> tuple[Array, Array]:
    """θ (P,) with the zeros and scales as given, and its
    covariance (P,P) with those not identifiable held at 0.

    A camera's turn that a joint's zero imitates has no meaning until that
    zero is agreed upon. curvature (P,P): the loss's inverse second
    derivative, along which the rest of θ follows; the covariance without it.
    """
    std = rig.prior[1]
    rows = np.arange(rig.of_joints.start, rig.of_scales.stop)
    given = np.array([one.value if one.identifiable else 0.0 for one in known])
    along = (covariance if curvature is None else curvature) / std / std[:, None]
    step = np.linalg.lstsq(
        along[np.ix_(rows, rows)], (given - theta[rows]) / std[rows], rcond=None
    )[0]
    scaled = covariance / std / std[:, None]
    held = rows[[not one.identifiable for one in known]]
    gain = np.linalg.lstsq(scaled[np.ix_(held, held)], scaled[held], rcond=None)[0]
    return theta + std * (along[:, rows] @ step), (scaled - scaled[:, held] @ gain) * std * std[
        :, None
    ]


def _camera_placement(rig: Rig, theta: Array, covariance: Array) -> Placement:
    """The camera's optical frame in its link: x to the right of
    the image, y down, z forward; or a tracker's own frame.
    """
    part = rig.of_camera(0)
    return _placement_on_link(
        rig, theta, covariance, slice(part.start, part.start + _POSE), camera=True
    )


def _marker_placement(rig: Rig, theta: Array, covariance: Array) -> Placement:
    return _placement_on_link(rig, theta, covariance, rig.of_carrier(0), camera=False)


def _placement_on_link(
    rig: Rig, theta: Array, covariance: Array, part: slice, camera: bool
) -> Placement:
    """A thing's pose on its link, with the covariance
    of θ (P,P) propagated by central differences.
    """

    def pose(at: Array) -> Array:
        return invert_transform(rig.camera_pose(0, at)) if camera else rig.carrier_pose(0, at)

    slopes = np.zeros((_POSE, part.stop - part.start))
    for k, index in enumerate(range(part.start, part.stop)):
        step = np.zeros(len(theta))
        step[index] = _STEP
        above = pose(theta + step)
        below = pose(theta - step)
        slopes[:3, k] = (above[:3, 3] - below[:3, 3]) / (2.0 * _STEP)
        slopes[3:, k] = vector_from_rotation(above[:3, :3] @ below[:3, :3].T) / (2.0 * _STEP)
    variance = np.einsum("ij,jk,ik->i", slopes, covariance[part, part], slopes)
    std = np.sqrt(np.maximum(variance, 0.0))
    thing = rig.cameras[0] if camera else rig.carriers[0]
    turns = camera or rig.carriers[0].turns
    return Placement(thing.name, thing.link, pose(theta), std[:3], std[3:], turns)


def _lens_with_std(rig: Rig, theta: Array, covariance: Array) -> Lens:
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


def _unidentified_findings(
    cameras: Sequence[Placement], markers: Sequence[Placement], zeros: Sequence[Offset]
) -> Iterator[Finding]:
    """Yield a sentence for each thing that is not identifiable."""
    for one in (*cameras, *markers):
        if not one.identifiable:
            place = f"its place on {one.link} is known to {1e3 * one.place_std.max():.0f} mm"
            turn = f", its turn to {np.degrees(one.turn_std.max()):.0f}°" if one.turns else ""
            yield Finding("warning", f"{one.name}: not identifiable: {place}{turn} alone")
    for text in identifiability.describe_unidentified(zeros):
        yield Finding("info", f"{text}; the poses hold with it at 0")
