"""Poses of a frame in a topic's messages or in tf:
their six coordinates stand for joints.
"""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from ..logs.limits import Input
from ..logs.tables.frame_columns import poses_of_quaternions, sound_poses
from . import role_values
from .joint_names import topic_name
from .roles import Role, pose_field

_CHILD = re.compile(r"child_frame_id==[\"']([^\"']+)[\"']")
_PLACES = ("position", "translation")
_TURNS = ("orientation", "rotation")


def pose_paths(role: Role) -> tuple[str, ...]:
    """Paths to a pose's place x, y, z and quaternion x, y, z, w; empty for other joints."""
    if role.role != "joints" or not role.field or pose_field(role.topics[0]) is None:
        return ()
    which = int(role.field.endswith("transform"))
    place = (f"{role.field}.{_PLACES[which]}.{axis}" for axis in "xyz")
    return (*place, *(f"{role.field}.{_TURNS[which]}.{axis}" for axis in "xyzw"))


def frame_name(role: Role) -> str:
    """The frame whose poses a role holds: tf's child, or the topic's name."""
    child = _CHILD.search(role.field)
    return topic_name(role.topic) if child is None else child[1]


def signal_of_poses(
    role: Role,
    found: Sequence[role_values.Block],
    wanted: tuple[str, ...] | None,
    what: str,
    limits: Input,
) -> role_values.RoleSignal:
    """The six coordinates of a frame, m and rad; messages without a sound pose are counted."""
    rejected: Counter[str] = Counter()
    blocks = list[role_values.Block]()
    for rows, stamps, values in found:
        columns = [np.asarray(one).reshape(len(rows), -1) for one in values]
        if any(one.shape[1] != 1 or one.dtype.kind not in "fiu" for one in columns):
            rejected["not in the message, or several times"] += len(rows)
            continue
        blocks.append((rows, stamps, (np.hstack(columns),)))
    signal = role_values.signal_of_arrays(blocks)
    if not len(signal.rows):
        return signal._replace(rejected=Counter(signal.rejected) + rejected)
    place, turn = signal.values[:, :3], signal.values[:, 3:]
    sound = sound_poses(place, turn)
    rejected["a pose beyond 50 m, or a quaternion whose length is not 1"] += int((~sound).sum())
    stamps = None if signal.stamp_ns is None else signal.stamp_ns[sound]
    poses = poses_of_quaternions(frame_name(role), place[sound], turn[sound], what)
    coordinates = poses.coordinates
    block = (
        signal.rows[sound],
        stamps,
        (tuple(coordinates), np.column_stack(list(coordinates.values()))),
    )
    chosen = [block] if sound.any() else []
    named = role_values.joints_by_name(chosen, wanted, what, limits=limits)
    return named._replace(rejected=Counter(named.rejected) + Counter(signal.rejected) + rejected)
