"""What a user knows beforehand of the first camera ([camera]:
lens and place) and a marker ([marker]), as hints with doubt.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from ..errors import ConfigError
from ..io.atomic_files import read_limited_text as read_text
from ..kinematics.camera import lens_without_distortion
from ..kinematics.links import FREE_LENS, INFO_LENS, CameraHint, MarkerHint
from ..kinematics.robot import Robot
from ..kinematics.rotations import make_transform, rotation_from_rpy
from ..settings import CameraSettings, MarkerSettings
from ..types import Array, Features

_MOST_BYTES = 1 << 20
_PLACE = "x, y, z (m), roll, pitch, yaw (rad)"


def with_known(hint: CameraHint, known: CameraSettings, robot: Robot) -> CameraHint:
    """The hint of the first camera and the values of [camera]; ConfigError where that cannot be.

    A pose's doubt is that of the lens in the camera, which is what its unknowns are of.
    """
    if known.info is not None:
        lens, size = load_lens(Path(known.info))
        hint = replace(hint, lens=lens, lens_std=None, size=size)
    if known.focal is not None:
        hint = _with_focal(hint, known)
    _require_link("camera", known.link, robot)
    if known.link is not None:
        hint = replace(hint, link=known.link, pose=None)
    return hint if known.place is None else _with_place(hint, known)


def _with_focal(hint: CameraHint, known: CameraSettings) -> CameraHint:
    assert known.focal is not None
    width, height = hint.size or hint.extent or (640, 480)
    numbers = (
        lens_without_distortion(known.focal, width, height)
        if hint.lens is None
        else hint.lens.copy()
    )
    numbers[0] = np.log(known.focal)
    std = (FREE_LENS if hint.lens is None else INFO_LENS).copy()
    std[0] = known.focal_std
    return replace(hint, lens=numbers, lens_std=std)


def _with_place(hint: CameraHint, known: CameraSettings) -> CameraHint:
    pose, std = _known_pose("camera", hint.link, known)
    return replace(hint, pose=pose, pose_std=std)


def known_markers(
    known: MarkerSettings, features: Sequence[Features], robot: Robot
) -> dict[str, MarkerHint]:
    """What [marker] says of a marker, by its name; empty without it.

    ConfigError where the marker, its link or its place cannot be.
    """
    if known.link is None and known.place is None:
        return {}
    _require_link("marker", known.link, robot)
    boards = {name: set(points[0]) for one in features for name, points in one.boards.items()}
    corners = set().union(*boards.values())
    tracks = {name for one in features for name in one.tracks if name not in corners}
    names = sorted({name.rpartition("/")[2] for name in (*boards, *tracks)})
    chosen = known.name or (names[0] if len(names) == 1 else None)
    if chosen not in names:
        found = "several" if known.name is None else repr(known.name)
        raise ConfigError(f"[marker] name: found {found}, possible: {', '.join(names[:30])}")
    pose, std = (
        (None, np.zeros(6)) if known.place is None else _known_pose("marker", known.link, known)
    )
    return {chosen: MarkerHint(known.link, pose, std)}


def _require_link(section: str, link: str | None, robot: Robot) -> None:
    if link is not None and link not in robot.links:
        raise ConfigError(
            f"[{section}] link: found {link!r}, possible: {', '.join(robot.links[:30])}"
        )


def _known_pose(
    section: str, link: str | None, known: CameraSettings | MarkerSettings
) -> tuple[Array, Array]:
    """A given pose (4,4) in its link, m, and its std (6,), m and rad."""
    assert known.place is not None
    if link is None:
        raise ConfigError(f"[{section}] place: in which link? give [{section}] link as well")
    if len(known.place) != 6:
        raise ConfigError(
            f"[{section}] place: found {len(known.place)} numbers, possible: 6: {_PLACE}"
        )
    values = np.array(known.place)
    std = np.array([known.place_std] * 3 + [np.radians(known.turn_std)] * 3)
    return make_transform(rotation_from_rpy(values[3:]), values[:3]), std


def load_lens(path: Path) -> tuple[Array, tuple[int, int]]:
    """The six numbers of a lens and the size (px) of its images from a CameraInfo in YAML.

    ConfigError where the file has none. Distortion other than radial is left out.
    """
    where = f"[camera] info: {path}"
    try:
        values = YAML(typ="safe", pure=True).load(read_text(path, _MOST_BYTES))
    except (OSError, UnicodeDecodeError, YAMLError, RecursionError) as problem:
        raise ConfigError(
            f"{where}: cannot be read as YAML ({' '.join(str(problem).split())[:150]})"
        ) from problem
    width, height = (
        _require_number(values, name, where) for name in ("image_width", "image_height")
    )
    matrix = _require_number_list(values, "camera_matrix", 9, where)
    distortion = _require_number_list(values, "distortion_coefficients", 4, where)
    if matrix[0] <= 0.0 or matrix[4] <= 0.0 or width < 1.0 or height < 1.0:
        raise ConfigError(
            f"{where}: found focal lengths {matrix[0]:g}, {matrix[4]:g} px, possible: "
            "positive numbers"
        )
    numbers = [
        np.log(matrix[0]),
        np.log(matrix[4] / matrix[0]),
        matrix[2],
        matrix[5],
        *distortion[:2],
    ]
    return np.array(numbers), (int(width), int(height))


def _require_number(values: Any, name: str, where: str) -> float:
    found = values.get(name) if isinstance(values, dict) else None
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise ConfigError(f"{where}: {name}: found {str(found)[:50]!r}, possible: a number")
    return float(found)


def _require_number_list(values: Any, name: str, fewest: int, where: str) -> Array:
    part = values.get(name)
    found = part.get("data") if isinstance(part, dict) else None
    sound = isinstance(found, list) and len(found) >= fewest
    if not sound or not all(isinstance(one, int | float) and abs(one) < 1e9 for one in found or ()):
        raise ConfigError(
            f"{where}: {name}: found {str(found)[:80]}, possible: data: a list of {fewest} numbers"
        )
    return np.array(found, float)
