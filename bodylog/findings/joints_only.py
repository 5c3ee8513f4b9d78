"""Logs without a body: encoders alone, without
images, and remarks on the quality of their readings.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..body_model import BodyModel, Noise, TouchConstants
from ..errors import FormatError, LogError, UsageError
from ..robot import joint_limits
from ..robot import model as robot_model
from ..settings import Settings
from ..types import Features, Finding, Recording, Series
from ..wording import list_in_words


def read_joints_alone(
    log: Path, settings: Settings, body: BodyModel | None = None
) -> tuple[Recording, Features]:
    """Read a log's joints, with remarks on their readings;
    LogError without joints. `body`: the one that is used.
    """
    from ..recording import recording

    read = recording.read_recording(log, settings, settings.input.strict)
    if read.signals.joints is None or not len(read.signals.joints.t):
        without = ", and no --body to find them by images" if body is None else ""
        raise LogError(f"{log}: no joint readings{without}; type: bodylog info {log}")
    odd = () if read.signals.poses else _reading_findings(read.signals.joints)
    unused = (_no_body(read),) if body is None else ()
    findings = (*unused, *odd, *_outside_limit_findings(log, read.signals.joints, settings))
    return read, Features(
        read.signals.joints, {}, None, (), (), {}, findings, poses=read.signals.poses
    )


def _no_body(read: Recording) -> Finding:
    """The remark that no body is used, and which cameras are ignored."""
    unseen = [path for role, path in read.facts.roles.items() if role.partition("/")[0] == "camera"]
    unused = (
        f"; images of {', '.join(unseen)} are not used: type --body body.npz, which fit writes"
        if unseen
        else ""
    )
    text = f"no --body: encoders alone, which do not show constant offsets{unused}"
    return Finding("warning" if unseen else "info", text)


def _reading_findings(joints: Series) -> Iterator[Finding]:
    """Yield remarks on readings: gaps, repeats, joints without readings."""
    t = joints.t
    steps = np.diff(joints.t)
    # longer than twenty usual steps, and half a second
    if len(steps) and (pause := steps > max(20.0 * np.median(steps), 0.5)).any():
        pauses = [
            f"{at:.3f} s for {long:.2f} s"
            for at, long in zip(t[:-1][pause], steps[pause], strict=True)
        ]
        yield Finding("warning", f"joints: no reading from {list_in_words(pauses, ' times')}")
    share = (
        (np.diff(joints.values, axis=0) == 0.0).mean(axis=0)
        if len(t) > 1
        else np.zeros(len(joints.names))
    )
    if often := [
        f"{joints.names[j]} {share[j]:.0%}"
        for j in np.argsort(-share, kind="stable")
        if share[j] > 0.5
    ]:
        yield Finding(
            "info",
            f"joints: readings that repeat the one before: {list_in_words(often)}, as at "
            "rest or in steps",
        )
    if mute := _list_mute_joints(joints):
        yield Finding("warning", f"joints: {', '.join(mute)}: no reading is a number")


def _list_mute_joints(joints: Series) -> list[str]:
    return [
        name
        for name, y in zip(joints.names, joints.values.T, strict=True)
        if not np.isfinite(y).any()
    ]


def _outside_limit_findings(log: Path, joints: Series, settings: Settings) -> Iterator[Finding]:
    """Remarks on joints beyond the limits of their URDF; the log's own URDF may be invalid."""
    try:
        yield from joint_limits.limit_findings(
            joints, *robot_model.joint_limits_of_log(log, settings)
        )
    except FormatError as problem:
        if settings.kinematics.urdf is not None:
            raise
        yield Finding("info", f"joints' limits are not known: {problem}")


def without_body(read: Recording, settings: Settings) -> BodyModel:
    """A body of all joints with readings, or those wanted,
    without other senses; UsageError for an unknown joint.
    """
    from .. import estimation

    assert read.signals.joints is not None
    mute = _list_mute_joints(read.signals.joints)
    wanted = settings.body.joints
    known = [name for name in read.signals.joints.names if name not in mute]
    if unknown := [name for name in wanted or () if name not in known]:
        raise UsageError(
            f"[body] joints: found {unknown[0]!r}, possible: {', '.join(known)}; type: "
            "bodylog info LOG"
        )
    names = tuple(wanted or known)
    # joints that never move keep this process noise, 1 rad²/s³; others learn theirs
    noise = Noise((joint_limits.ENCODER_STEP_RAD**2 / 12.0,) * len(names), {}, (1.0,) * len(names))
    found = BodyModel(names, {}, noise, TouchConstants(1.0, 0.005), {})
    estimation.check_estimation_settings(found, settings.estimate)
    return found
