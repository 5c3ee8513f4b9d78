"""Features of a recording: tracks, touches and poses found in it, or stored in it by an earlier run."""

from dataclasses import replace

from .logs.protocol import Progress
from .settings import Settings, wanted
from .types import Features, Finding, Recording


def moving(read: Recording, settings: Settings, progress: Progress | None) -> Features:
    """The features of a recording, or those stored in it by an earlier run."""
    from . import perception

    if read.features is None:
        return replace(perception.observe(read, settings, progress), cameras=_cameras(read))
    carried = Finding("info", "the log holds tracks of an earlier run, which are used; its images are not read")
    findings = (*read.features.findings, carried)
    boards = perception.rigid_groups(wanted(read.settings), read.features.tracks)
    tracks, health = {**read.tracks, **read.features.tracks}, {**read.features.health, **read.track_health}
    return replace(read.features, tracks=tracks, health=health, findings=findings, boards=boards)


def still_poses(read: Recording, settings: Settings, progress: Progress | None) -> Features:
    """Features of still poses: places from their table, and features found in its images; strokes need motion."""
    carried = read.features or Features(read.joints, {}, None, (), (), {})
    tracks, health = {**read.tracks, **carried.tracks}, {**carried.health, **read.track_health}
    carried = replace(carried, tracks=tracks, health=health)
    if read.frames is not None:
        from . import perception

        seen = perception.observe(replace(read, features=None), settings, progress)
        carried = replace(seen, tracks={**seen.tracks, **carried.tracks}, health={**seen.health, **carried.health})
    return replace(carried, cameras=_cameras(read), strokes=(), synchrony=())


def completed(read: Recording, found: Features) -> Features:
    """Features with the recording's joints."""
    return replace(found, joints=read.joints, reference=read.reference, poses=read.poses, beside=read.beside)


def _cameras(read: Recording) -> dict[str, str]:
    """The topics of the cameras by name, "" for the first."""
    roles = {role.partition("/"): path for role, path in read.roles.items()}
    return {name: path for (role, _, name), path in roles.items() if role == "camera"}
