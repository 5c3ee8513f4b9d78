"""A log without a body: what its joints' own sensors show, its images left alone."""

from pathlib import Path

from .errors import LogError
from .settings import Settings
from .types import BodyModel, Features, Recording


def joints_alone(log: Path, settings: Settings) -> tuple[Recording, Features]:
    """A log's joints without its pictures, and what is odd about how they were read; LogError without joints."""
    from . import estimation
    from .logs import recording

    read = recording.read(log, settings, settings.input.strict)
    if read.joints is None or not len(read.joints.t):
        raise LogError(f"{log}: no joint readings, and no --body to find them by images; type: bodylog info {log}")
    unseen = [path for role, path in read.roles.items() if role.partition("/")[0] == "camera"]
    findings = (*estimation.unlearned_body(unseen), *estimation.readings(read.joints))
    return read, Features(read.joints, {}, None, (), (), {}, findings)


def without_body(read: Recording, settings: Settings) -> BodyModel:
    """What stands for a body where none was learned: the joints' names, and how they move at most."""
    from . import estimation

    assert read.joints is not None
    found = estimation.joints_body(read.joints, settings.body.joints)
    estimation.check(found, settings.estimate)
    return found
