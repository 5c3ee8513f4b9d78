"""Poses of a frame in the columns of a table: a matrix, a
place with a quaternion, or one with roll, pitch and yaw.

A pose stands in a log as six coordinates, as if three sliding and three turning joints carried the
frame: x, y, z in m, then three rotations in rad. Their order is rz, ry, rx, or rz2, rx2, ry2 where
the first is near its singularity: other names, for they are other angles.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import LogError
from ..records import Array

ORDERS = (("rz", "ry", "rx"), ("rz2", "rx2", "ry2"))
"""Orders of the rotations, each about an axis that the ones before have turned."""
PLACE = ("x", "y", "z")
TOOL = "tool"
"""The name of a frame whose columns have no prefix."""
_MATRIX = re.compile(r"(?P<name>.+?)[_.](?P<row>[0-3])[_.]?(?P<column>[0-3])")
_PART = re.compile(r"(?:(?P<name>.+?)[_.])?(?P<axis>[xyz]|q[xyzw]|roll|pitch|yaw)", re.IGNORECASE)
_QUATERNION = ("qx", "qy", "qz", "qw")
_ANGLES = ("roll", "pitch", "yaw")
_FARTHEST_M = 50.0
_MOST_OFF = 0.02
"""Largest error of an entry of R'R; tables with three decimals have 0.002."""


@dataclass(frozen=True, eq=False)
class FramePoses:
    """A frame's poses by row: its columns · place (N,3)
    m · rotation (N,3,3), NaN where a row has none.
    """

    name: str
    columns: tuple[str, ...]
    place: Array
    rotation: Array

    @property
    def coordinates(self) -> dict[str, Array]:
        """The six coordinates (N,) by name: NAME.x, .y, .z
        in m, then the rotations in rad, in their order.
        """
        found = {axis: self.place[:, k] for k, axis in enumerate(PLACE)}
        found |= _rotation_angles(self.rotation)
        return {f"{self.name}.{axis}": values for axis, values in found.items()}


def frame_poses(numbers: Mapping[str, Array], path: str) -> list[FramePoses]:
    """Every frame in a table's columns; LogError where
    lengths cannot be in m, or matrices are no rotations.
    """
    return [*_read_matrices(numbers, path), *_frame_positions(numbers, path)]


def poses_of_quaternions(
    name: str, place: Array, turn: Array, path: str, columns: tuple[str, ...] = ()
) -> FramePoses:
    """A frame's poses from places (N,3) m and quaternions
    x, y, z, w (N,4); LogError where they are none.
    """
    rotation = _of_quaternions(turn, name, path)
    return _check_frame_poses(FramePoses(name, columns, place, rotation), path)


def sound_poses(place: Array, turn: Array) -> Array:
    """Which (N,) places (N,3) m and quaternions (N,4) are poses of a robot."""
    near: Array = np.asarray((np.abs(place) <= _FARTHEST_M).all(axis=1))
    return np.asarray(near & (np.abs(np.linalg.norm(turn, axis=1) - 1.0) <= _MOST_OFF))


def frame_of(joints: tuple[str, ...]) -> str | None:
    """The frame whose six coordinates these joints are; None where they are others."""
    name = joints[0].rpartition(".")[0] if joints else ""
    possible = [tuple(f"{name}.{axis}" for axis in (*PLACE, *order)) for order in ORDERS]
    return name if joints in possible else None


def _read_matrices(numbers: Mapping[str, Array], path: str) -> Iterator[FramePoses]:
    cells: dict[str, dict[tuple[int, int], str]] = {}
    for column in numbers:
        if match := _MATRIX.fullmatch(column):
            cells.setdefault(match["name"], {})[int(match["row"]), int(match["column"])] = column
    for name, found in cells.items():
        if any((row, column) not in found for row in range(3) for column in range(4)):
            continue
        values = np.array(
            [[numbers[found[row, column]] for column in range(4)] for row in range(3)]
        )
        matrix = np.moveaxis(values, -1, 0)
        yield _check_frame_poses(
            FramePoses(name, tuple(found.values()), matrix[:, :, 3], matrix[:, :, :3]), path
        )


def _frame_positions(numbers: Mapping[str, Array], path: str) -> Iterator[FramePoses]:
    parts: dict[str, dict[str, str]] = {}
    for column in numbers:
        if match := _PART.fullmatch(column):
            parts.setdefault(match["name"] or TOOL, {})[match["axis"].lower()] = column
    for name, found in parts.items():
        turned = next((axes for axes in (_QUATERNION, _ANGLES) if set(axes) <= set(found)), None)
        if turned is None or not set(PLACE) <= set(found):
            continue
        place, turn = (
            np.column_stack([numbers[found[axis]] for axis in axes]) for axes in (PLACE, turned)
        )
        columns = tuple(found[axis] for axis in (*PLACE, *turned))
        if turned == _QUATERNION:
            yield poses_of_quaternions(name, place, turn, path, columns)
            continue
        rotation = _of_angles(turn, name, path)
        yield _check_frame_poses(FramePoses(name, columns, place, rotation), path)


def _of_quaternions(turn: Array, name: str, path: str) -> Array:
    length = np.linalg.norm(turn, axis=1)
    wrong = np.abs(length - 1.0) > _MOST_OFF
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{path}: row {row + 1}: quaternion of {name} has the length {length[row]:.3g}; "
            "possible: 1"
        )
    x, y, z, w = (turn / length[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _of_angles(turn: Array, name: str, path: str) -> Array:
    largest = float(np.nanmax(np.abs(turn), initial=0.0))
    if largest > 2.0 * np.pi:
        raise LogError(
            f"{path}: roll, pitch, yaw of {name}: found {largest:.4g}; possible: rad, at "
            "most a turn"
        )
    roll, pitch, yaw = turn.T
    return np.asarray(
        _rotations_about_axis("z", yaw)
        @ _rotations_about_axis("y", pitch)
        @ _rotations_about_axis("x", roll)
    )


def _rotations_about_axis(axis: str, angle: Array) -> Array:
    """Rotations (N,3,3) about one axis."""
    k = PLACE.index(axis)
    i = (k + 1) % 3
    j = (k + 2) % 3
    found = np.zeros((len(angle), 3, 3))
    found[:, k, k] = 1.0
    found[:, i, i] = np.cos(angle)
    found[:, j, j] = np.cos(angle)
    found[:, j, i] = np.sin(angle)
    found[:, i, j] = -np.sin(angle)
    return found


def _check_frame_poses(found: FramePoses, path: str) -> FramePoses:
    farthest = float(np.nanmax(np.abs(found.place), initial=0.0))
    if farthest > _FARTHEST_M:
        raise LogError(
            f"{path}: {found.name}: a coordinate of its place is {farthest:.4g}; possible: "
            "m, not mm"
        )
    r = found.rotation
    off = np.abs(r.transpose(0, 2, 1) @ r - np.eye(3)).max(axis=(1, 2), initial=0.0)
    wrong = np.flatnonzero((off > _MOST_OFF) | (np.linalg.det(r) < 0.0))
    if len(wrong):
        row = int(wrong[0])
        raise LogError(
            f"{path}: row {row + 1}: the matrix of {found.name} is no rotation; possible: "
            "row r, column c"
        )
    return found


def _rotation_angles(rotation: Array) -> dict[str, Array]:
    """The rotations (N,) rad in the order farther from its
    singularity, each within half a turn of its middle.
    """
    known: Array = np.asarray(np.isfinite(rotation).all(axis=(1, 2)))
    r = np.where(known[:, None, None], rotation, np.nan)
    first = np.hypot(r[:, 0, 0], r[:, 1, 0])
    second = np.hypot(r[:, 0, 1], r[:, 1, 1])
    if np.nanmin(first, initial=1.0) >= min(np.nanmin(second, initial=1.0), 0.5):
        angles = {
            "rz": np.arctan2(r[:, 1, 0], r[:, 0, 0]),
            "ry": np.arctan2(-r[:, 2, 0], first),
            "rx": np.arctan2(r[:, 2, 1], r[:, 2, 2]),
        }
    else:
        angles = {
            "rz2": np.arctan2(-r[:, 0, 1], r[:, 1, 1]),
            "rx2": np.arctan2(r[:, 2, 1], second),
            "ry2": np.arctan2(-r[:, 2, 0], r[:, 2, 2]),
        }
    return {axis: _unwrap_near_mean(angle) for axis, angle in angles.items()}


def _unwrap_near_mean(angle: Array) -> Array:
    """Angles (N,) within half a turn of a quarter turn
    near their mean, so that logs of one robot agree.
    """
    mean = np.arctan2(np.nanmean(np.sin(angle)), np.nanmean(np.cos(angle)))
    quarters = int(np.round(mean / (np.pi / 2.0)))
    centre = np.pi / 2.0 * (2 if quarters == -2 else quarters)
    return np.asarray(centre + (angle - centre + np.pi) % (2.0 * np.pi) - np.pi)
