"""Which postures to record next for a body:
within a URDF's limits, or among those of a table.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..body import storage
from ..body.kinematic.next_poses import Proposal, propose_postures, random_postures
from ..body_model import BodyModel
from ..errors import EvidenceError, LogError, ModelError, UsageError
from ..kinematics import urdf as urdf_file
from ..recording import recording
from ..settings import Settings
from ..types import Array


def propose_next_postures(
    body: Path, count: int, urdf: Path | None, among: Path | None
) -> Proposal:
    """The postures that tell a body most about all others,
    of a table of postures or at random within joint limits.

    UsageError without a URDF and a table.
    """
    if among is None and urdf is None:
        needed = "--next needs the joints' limits, or postures to choose from"
        raise UsageError(f"{needed}; type: --urdf ROBOT.urdf, or --among POSES.csv")
    learned = storage.load_body(body)
    try:
        if among is not None:
            return propose_postures(learned, count, _postures_of_table(learned, among))
        assert urdf is not None
        joints = urdf_file.load_urdf(urdf).joints
        limits = {joint.name: joint.limits for joint in joints if joint.limits is not None}
        return propose_postures(learned, count, random_postures(learned, limits))
    except (ModelError, EvidenceError) as problem:
        raise type(problem)(f"{body}: {problem}") from problem


def _postures_of_table(learned: BodyModel, table: Path) -> Array:
    """The postures (K,M) of a log of still poses, in the order of the body's joints."""
    joints = recording.read_recording(table, Settings(), False).signals.joints
    names = () if joints is None else joints.names
    missing = [name for name in learned.joints if name not in names]
    if joints is None or missing:
        have = ", ".join(names) or "none"
        raise LogError(f"{table}: joint {missing[0]!r} of the body is missing; it has {have}")
    postures = joints.values[:, [names.index(name) for name in learned.joints]]
    return np.asarray(postures[np.isfinite(postures).all(axis=1)])


def posture_lines(found: Proposal) -> Iterator[str]:
    """Yield each posture in degrees (mm where a joint
    slides), and the error in the image that it leaves.
    """
    yield (
        f"now the body predicts {'images' if found.unit == 'px' else 'points'} to ± "
        f"{found.std_px[0]:.2f} {found.unit}; record, in this order:"
    )
    for number, (posture, left) in enumerate(zip(found.postures, found.std_px[1:], strict=True), 1):
        joints = zip(found.joints, posture, found.sliding, strict=True)
        values = [f"{name} {_joint_value_text(value, slides)}" for name, value, slides in joints]
        yield f"{number}: {', '.join(values)}; then ± {left:.2f} {found.unit}"


def _joint_value_text(value: float, slides: bool) -> str:
    return f"{1e3 * value:.0f} mm" if slides else f"{np.degrees(value):.1f}°"


def postures_as_values(found: Proposal) -> dict[str, Any]:
    """As plain values: postures in rad or m by joint, and px or mm."""
    return {
        "postures": [
            dict(zip(found.joints, posture.tolist(), strict=True)) for posture in found.postures
        ],
        f"std_{found.unit}": found.std_px.tolist(),
    }
