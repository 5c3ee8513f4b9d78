"""Features of a recording: tracks, touches and poses
found in it, or stored in it by an earlier run.
"""

from dataclasses import replace

from ..logs.protocol import Progress
from ..settings import Settings, list_configured_sources
from ..types import Features, Finding, Recording


def moving_features(read: Recording, settings: Settings, progress: Progress | None) -> Features:
    """The features of a recording, or those stored in it by an earlier run."""
    from .. import perception

    if read.features is None:
        return replace(
            perception.observe_recording(read, settings, progress), cameras=_topics_by_camera(read)
        )
    carried = Finding(
        "info", "the log holds tracks of an earlier run, which are used; its images are not read"
    )
    findings = (*read.features.findings, carried)
    boards = perception.rigid_groups(list_configured_sources(read.settings), read.features.tracks)
    tracks = {**read.tracks, **read.features.tracks}
    health = {**read.features.health, **read.track_health}
    return replace(read.features, tracks=tracks, health=health, findings=findings, boards=boards)


def still_pose_features(read: Recording, settings: Settings, progress: Progress | None) -> Features:
    """Features of still poses: places from their table,
    and features found in its images; strokes need motion.
    """
    carried = read.features or Features(read.joints, {}, None, (), (), {})
    tracks = {**read.tracks, **carried.tracks}
    health = {**carried.health, **read.track_health}
    carried = replace(carried, tracks=tracks, health=health)
    if read.frames is not None:
        from .. import perception

        seen = perception.observe_recording(replace(read, features=None), settings, progress)
        carried = replace(
            seen, tracks={**seen.tracks, **carried.tracks}, health={**seen.health, **carried.health}
        )
    return replace(carried, cameras=_topics_by_camera(read), strokes=(), synchrony=())


def add_recorded_joints(read: Recording, found: Features) -> Features:
    """Features with the recording's joints."""
    return replace(
        found, joints=read.joints, reference=read.reference, poses=read.poses, beside=read.beside
    )


def _topics_by_camera(read: Recording) -> dict[str, str]:
    """The topics of the cameras by name, "" for the first."""
    roles = {role.partition("/"): path for role, path in read.roles.items()}
    return {name: path for (role, _, name), path in roles.items() if role == "camera"}
