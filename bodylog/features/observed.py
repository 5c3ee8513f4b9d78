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

    if read.signals.features is None:
        return replace(
            perception.observe_recording(read, settings, progress), cameras=_topics_by_camera(read)
        )
    carried = Finding(
        "info", "the log holds tracks of an earlier run, which are used; its images are not read"
    )
    findings = (*read.signals.features.findings, carried)
    boards = perception.rigid_groups(
        list_configured_sources(read.facts.settings), read.signals.features.tracks
    )
    tracks = {**read.signals.tracks, **read.signals.features.tracks}
    health = {**read.signals.features.health, **read.facts.track_health}
    return replace(
        read.signals.features, tracks=tracks, health=health, findings=findings, boards=boards
    )


def still_pose_features(read: Recording, settings: Settings, progress: Progress | None) -> Features:
    """Features of still poses: places from their table,
    and features found in its images; strokes need motion.
    """
    carried = read.signals.features or Features(read.signals.joints, {}, None, (), (), {})
    tracks = {**read.signals.tracks, **carried.tracks}
    health = {**carried.health, **read.facts.track_health}
    carried = replace(carried, tracks=tracks, health=health)
    if read.cameras.frames is not None:
        from .. import perception

        signals = replace(read.signals, features=None)
        seen = perception.observe_recording(replace(read, signals=signals), settings, progress)
        carried = replace(
            seen, tracks={**seen.tracks, **carried.tracks}, health={**seen.health, **carried.health}
        )
    return replace(carried, cameras=_topics_by_camera(read), strokes=(), synchrony=())


def add_recorded_joints(read: Recording, found: Features) -> Features:
    """Features with the recording's joints."""
    return replace(
        found,
        joints=read.signals.joints,
        reference=read.signals.reference,
        poses=read.signals.poses,
        beside=read.facts.beside,
    )


def _topics_by_camera(read: Recording) -> dict[str, str]:
    """The topics of the cameras by name, "" for the first."""
    roles = {role.partition("/"): path for role, path in read.facts.roles.items()}
    return {name: path for (role, _, name), path in roles.items() if role == "camera"}
