"""Logs without a body: encoders alone, without
images, and remarks on the quality of their readings.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..body_model import BodyModel
from ..errors import LogError
from ..robot import joint_limits
from ..robot.encoder_body import list_mute_joints
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
    unused = (_no_body(read),) if body is None else ()
    odd = () if read.signals.poses else _reading_findings(read.signals.joints)
    beyond = joint_limits.outside_limit_findings(log, read.signals.joints, settings)
    findings = (*unused, *odd, *beyond)
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
    if mute := list_mute_joints(joints):
        yield Finding("warning", f"joints: {', '.join(mute)}: no reading is a number")
