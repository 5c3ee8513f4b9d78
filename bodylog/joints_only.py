"""A log without a body: what its joints' own sensors show, its images left alone."""

from collections.abc import Iterator
from pathlib import Path

from . import robot_model
from .body_model import BodyModel
from .errors import FormatError, LogError
from .settings import Settings
from .types import Features, Finding, Recording, Series


def joints_alone(log: Path, settings: Settings) -> tuple[Recording, Features]:
    """A log's joints without its pictures, and what is odd about how they were read; LogError without joints."""
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
    """Which joints leave the limits of their URDF; the log's own, which nobody asked for, may be unreadable."""
    from . import estimation

    try:
        yield from estimation.limit_findings(joints, *robot_model.limits(log, settings))
    except FormatError as problem:
        if settings.kinematics.urdf is not None:
            raise
        yield Finding("info", f"joints' limits are not known: {problem}")


def without_body(read: Recording, settings: Settings) -> BodyModel:
    """What stands for a body where none was learned: the joints' names, and how they move at most."""
    from . import estimation

    assert read.joints is not None
    found = estimation.joints_body(read.joints, settings.body.joints)
    estimation.check(found, settings.estimate)
    return found
