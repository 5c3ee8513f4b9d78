"""Logs without a body: encoders alone, without images."""

from collections.abc import Iterator
from pathlib import Path

from . import robot_model
from .body_model import BodyModel
from .errors import FormatError, LogError
from .settings import Settings
from .types import Features, Finding, Recording, Series


def joints_alone(log: Path, settings: Settings) -> tuple[Recording, Features]:
    """Read a log's joints, with remarks on their readings; LogError without joints."""
    from . import estimation
    from .recording import recording

    read = recording.read(log, settings, settings.input.strict)
    if read.joints is None or not len(read.joints.t):
        raise LogError(f"{log}: no joint readings, and no --body to find them by images; type: bodylog info {log}")
    unseen = [path for role, path in read.roles.items() if role.partition("/")[0] == "camera"]
    odd = (*(() if read.poses else estimation.reading_findings(read.joints)), *_outside(log, read.joints, settings))
    findings = (*estimation.no_body_findings(unseen), *odd)
    return read, Features(read.joints, {}, None, (), (), {}, findings, poses=read.poses)


def _outside(log: Path, joints: Series, settings: Settings) -> Iterator[Finding]:
    """Remarks on joints beyond the limits of their URDF; the log's own URDF may be invalid."""
    from . import estimation

    try:
        yield from estimation.limit_findings(joints, *robot_model.limits(log, settings))
    except FormatError as problem:
        if settings.kinematics.urdf is not None:
            raise
        yield Finding("info", f"joints' limits are not known: {problem}")


def without_body(read: Recording, settings: Settings) -> BodyModel:
    """A body of joint names alone, with limits on their motion."""
    from . import estimation

    assert read.joints is not None
    found = estimation.joints_body(read.joints, settings.body.joints)
    estimation.check(found, settings.estimate)
    return found
