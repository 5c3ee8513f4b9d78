"""What a body knows of its surface: a camera on a URDF,
rebuilt as a model, and stored as plain arrays and names.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..body_model import PATCH_PX, LandmarkMap, Noise, Surface, SurfaceCamera
from ..errors import FormatError
from ..io.values import encodable_text
from ..types import Array, Features
from .kinematic.storage import insist_rigid, insist_sound

if TYPE_CHECKING:
    from ..kinematics.joint_motion import JointCurve
    from ..kinematics.landmarks import LandmarkModel
    from ..kinematics.links import Space

SHAPES = {
    "anchor": "44",
    "lens": "6",
    "doubt": "c",
    "unknowns": "p",
    "covariance": "pp",
    "delays": "l",
    "delay_std": "l",
    "picture": "hw",
}
"""Arrays of a camera: c is 12, p the unknowns, l logs, h and w the picture's sides."""
MAP_SHAPES = {
    "body": "k",
    "places": "k3",
    "precision": "k33",
    "slopes": "k3p",
    "view_of": "v",
    "patches": "vss",
    "view_slopes": "v23",
}
"""Arrays of its map, where it has one: k landmarks, v views of s by s pixels."""
_POSE_AND_LENS = 12
_MOST_SIDE = 1 << 20
_LARGEST = 1e6


def landmark_model(
    surface: Surface, camera: SurfaceCamera, motions: "Sequence[JointCurve]" = ()
) -> "LandmarkModel":
    """The model of one camera, without belief, for the motions of some logs."""
    from ..kinematics.landmark_fit import build_model
    from ..kinematics.rig import RigCamera

    space = surface_space(surface)
    placed = RigCamera(
        f"camera {camera.name}".strip(), camera.link, camera.anchor, camera.lens, camera.doubt
    )
    return build_model(space, placed, motions, surface.zero_std)


def surface_space(surface: Surface) -> "Space":
    """The links of its robot, by the joints of the body."""
    from ..kinematics import urdf
    from ..kinematics.links import Space

    robot = urdf.parse_urdf(surface.urdf, "the body's URDF")
    return Space(robot, tuple(surface.joint_of.values()), dict(surface.still), surface.zero_std)


def joint_noise(features: Sequence[Features], names: tuple[str, ...]) -> Noise:
    """Noise of the encoders and of the motion of some joints, by evidence on all logs."""
    from . import noise_estimates
    from .data.pairs import smooth_all_joints

    return noise_estimates.learn_noise(
        [joint.acceleration for joint in smooth_all_joints(features, names)], {}, {}
    )


def surface_names(surface: Surface) -> dict[str, Any]:
    """The part of the header."""
    cameras = [
        {
            "name": camera.name,
            "topic": camera.topic,
            "link": camera.link,
            "size": list(camera.size),
            "mapped": camera.landmarks is not None,
        }
        for camera in surface.cameras
    ]
    return {
        "urdf": surface.urdf,
        "joint_of": dict(surface.joint_of),
        "still": dict(surface.still),
        "zero_std": surface.zero_std,
        "cameras": cameras,
    }


def surface_arrays(surface: Surface) -> dict[str, Array]:
    """The arrays of all cameras by their names in the file."""
    found = dict[str, Array]()
    for number, camera in enumerate(surface.cameras):
        where = f"surface.{number}"
        for field in SHAPES:
            found[f"{where}/{field}.npy"] = np.asarray(getattr(camera, field), np.float64)
        if camera.landmarks is not None:
            for field in MAP_SHAPES:
                kind = np.uint8 if field == "patches" else np.float64
                found[f"{where}/{field}.npy"] = np.asarray(getattr(camera.landmarks, field), kind)
    return found


def shapes_of(camera: Mapping[str, Any]) -> dict[str, str]:
    """The arrays of a camera of a checked header."""
    return {**SHAPES, **MAP_SHAPES} if camera["mapped"] else dict(SHAPES)


def check_surface(found: Any, joints: tuple[str, ...]) -> dict[str, Any]:
    """The part of a header; ValueError, naming the field, where it is invalid."""
    if not isinstance(found, dict):
        raise ValueError(f"surface: found {str(found)[:80]}, possible: a table")
    joint_of = {
        encodable_text(log): encodable_text(joint) for log, joint in dict(found["joint_of"]).items()
    }
    insist_sound(
        set(joint_of) == set(joints),
        "surface.joint_of",
        list(joint_of)[:4],
        "the URDF's joint of each joint",
    )
    joint_of = {name: joint_of[name] for name in joints}
    still = {
        encodable_text(joint): _check_number(f"surface.still.{joint}", angle)
        for joint, angle in dict(found["still"]).items()
    }
    zero_std = _check_number("surface.zero_std", found["zero_std"])
    insist_sound(zero_std >= 0.0, "surface.zero_std", zero_std, "0 rad and more")
    insist_sound(
        isinstance(found["urdf"], str), "surface.urdf", type(found["urdf"]).__name__, "a text"
    )
    cameras = [_check_camera(one) for one in found["cameras"]]
    insist_sound(bool(cameras), "surface.cameras", "none", "one or more")
    _insist_robot(found["urdf"], (*joint_of.values(), *still), [one["link"] for one in cameras])
    return {
        "urdf": found["urdf"],
        "joint_of": joint_of,
        "still": still,
        "zero_std": zero_std,
        "cameras": cameras,
    }


def _check_number(field: str, value: Any) -> float:
    sound = (
        isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST
    )
    insist_sound(sound, field, str(value)[:80], f"a number, at most {_LARGEST:g}")
    return float(value)


def _check_camera(found: Mapping[str, Any]) -> dict[str, Any]:
    size = found["size"]
    sides = size if isinstance(size, list) and len(size) == 2 else [0, 0]
    whole = all(
        isinstance(side, int) and not isinstance(side, bool) and 1 <= side <= _MOST_SIDE
        for side in sides
    )
    insist_sound(whole, "surface.cameras.size", str(size)[:80], "[width, height] in px")
    mapped = found.get("mapped", False)
    insist_sound(
        isinstance(mapped, bool), "surface.cameras.mapped", str(mapped)[:80], "true or false"
    )
    names_of_camera = {field: encodable_text(found[field]) for field in ("name", "topic", "link")}
    return {**names_of_camera, "size": tuple(sides), "mapped": mapped}


def _insist_robot(xml: str, joints: Sequence[str], links: Sequence[str]) -> None:
    from ..kinematics import urdf
    from ..kinematics.robot import MOVING

    try:
        robot = urdf.parse_urdf(xml, "surface.urdf")
    except FormatError as problem:
        raise ValueError(str(problem)) from problem
    for joint in joints:
        known = joint in robot.by_name and robot.by_name[joint].kind in MOVING
        insist_sound(known, "surface.joint_of", joint, "a joint of its URDF that moves")
    for link in links:
        insist_sound(link in robot.links, "surface.cameras.link", link, "a link of its URDF")


def build_surface(header: Mapping[str, Any], found: Sequence[Mapping[str, Array]]) -> Surface:
    """Build from a checked header and each camera's arrays; ValueError for inconsistent fields."""
    count = _POSE_AND_LENS + len(header["joint_of"]) + 1
    cameras = []
    for number, (about, own) in enumerate(zip(header["cameras"], found, strict=True)):
        where = f"surface.{number}"
        insist_rigid(own["anchor"], f"{where}/anchor")
        insist_sound(
            len(own["doubt"]) == _POSE_AND_LENS,
            f"{where}/doubt",
            len(own["doubt"]),
            f"{_POSE_AND_LENS} numbers",
        )
        insist_sound(
            (own["doubt"] > 0.0).all(),
            f"{where}/doubt",
            float(own["doubt"].min()),
            "positive numbers",
        )
        insist_sound(
            len(own["unknowns"]) == count,
            f"{where}/unknowns",
            len(own["unknowns"]),
            f"{count} numbers",
        )
        for field in ("lens", "unknowns"):
            largest = float(np.abs(own[field]).max())
            insist_sound(largest <= _LARGEST, f"{where}/{field}", largest, f"at most {_LARGEST:g}")
        insist_sound(
            _is_covariance(own["covariance"]),
            f"{where}/covariance",
            "another matrix",
            "a covariance",
        )
        insist_sound(
            (own["delay_std"] > 0.0).all(),
            f"{where}/delay_std",
            float(own["delay_std"].min()),
            "positive numbers",
        )
        fields_of_camera: dict[str, Any] = {
            field: about[field] for field in ("name", "topic", "link", "size")
        }
        fields_of_camera |= {field: own[field] for field in SHAPES}
        landmarks = _landmarks(where, own) if about["mapped"] else None
        cameras.append(SurfaceCamera(**fields_of_camera, landmarks=landmarks))
    fields = ("urdf", "joint_of", "still", "zero_std")
    surface = Surface(**{field: header[field] for field in fields}, cameras=tuple(cameras))
    for number, camera in enumerate(cameras):
        if camera.landmarks is not None:
            bodies = len(landmark_model(surface, camera).bodies)
            largest = int(camera.landmarks.body.max())
            insist_sound(
                largest < bodies, f"surface.{number}/body", largest, f"numbers below {bodies}"
            )
    return surface


def _landmarks(where: str, own: Mapping[str, Array]) -> LandmarkMap:
    """The map of a camera from its arrays; ValueError for inconsistent fields."""
    numbers = dict[str, Array]()
    for field, most in (("body", _MOST_SIDE), ("view_of", len(own["body"]) - 1)):
        value = own[field]
        whole = (value == np.floor(value)) & (value >= 0) & (value <= most)
        insist_sound(
            bool(whole.all()),
            f"{where}/{field}",
            value[~whole][:1],
            f"whole numbers from 0 to {most}",
        )
        numbers[field] = value.astype(int)
    insist_sound(
        bool((np.diff(numbers["view_of"]) >= 0).all()),
        f"{where}/view_of",
        "a fall",
        "ascending numbers",
    )
    side = own["patches"].shape[1]
    insist_sound(side == PATCH_PX, f"{where}/patches", f"{side} px", f"{PATCH_PX} px")
    for number, matrix in enumerate(own["precision"]):
        insist_sound(
            _is_covariance(matrix),
            f"{where}/precision",
            f"another matrix at {number}",
            "positive definite ones",
        )
    largest = max(float(np.abs(own[field]).max()) for field in ("places", "slopes", "view_slopes"))
    insist_sound(largest <= _LARGEST, f"{where}/places", largest, f"at most {_LARGEST:g}")
    return LandmarkMap(
        numbers["body"],
        own["places"],
        own["precision"],
        own["slopes"],
        numbers["view_of"],
        own["patches"],
        own["view_slopes"],
    )


def _is_covariance(matrix: Array) -> bool:
    """Whether a matrix (P,P) is symmetric and positive definite."""
    variance = np.diag(matrix)
    if not (variance > 0.0).all():
        return False
    scaled = matrix / np.sqrt(variance) / np.sqrt(variance)[:, None]
    if not np.allclose(scaled, scaled.T, atol=1e-9) or np.abs(scaled).max() > 1.0 + 1e-9:
        return False
    return bool(np.linalg.eigvalsh(scaled).min() > 0.0)
