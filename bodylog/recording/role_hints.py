"""Findings on guessed roles: the lines for robot.toml that name them, and alternative topics."""

import json
from collections.abc import Mapping, Sequence

from ..logs.images import messages
from ..logs.records import Finding, Topic
from ..settings import TopicSettings
from .cameras import camera_name_of_source
from .roles import (
    RANKS,
    ROLES,
    Role,
    camera_rank,
    is_raw,
    joints_rank,
    pose_field,
    problem_with_definition,
)


def advice_on_roles(found: Mapping[str, Role]) -> str:
    """The roles as one line for robot.toml."""
    paths = {role: [one.path for one in found.values() if one.role == role] for role in ROLES}
    lines = (
        f"{role} = {json.dumps(text if len(text) > 1 else text[0])}"
        for role, text in paths.items()
        if text
    )
    return f"topics = {{ {', '.join(lines)} }}"


def unused_joints(
    topics: Sequence[Topic], settings: TopicSettings, found: Mapping[str, Role]
) -> tuple[Finding, ...]:
    """Joint states besides those guessed to be the robot's, and what to type to use them."""
    others = sorted(
        {topic.name for topic in topics if is_raw(topic) and joints_rank(topic) is not None}
    )
    used = [role.topic for role in found.values() if role.role == "joints"]
    poses = sorted({topic.name for topic in topics if is_raw(topic) and pose_field(topic)})
    if settings.joints is None and poses and not used:
        text = "joints: none; poses may stand for them: type: [topics] joints = "
        return (Finding("info", text + json.dumps(poses[0])),)
    others = [name for name in others if used and name not in used]
    if settings.joints is not None or not others:
        return ()
    text = f"joints: {', '.join(used)} is used, {', '.join(others)} not"
    typed = (
        f"type: [topics] joints = {json.dumps(others[0])}; for both, joints = "
        f"{json.dumps([*used, others[0]])}"
    )
    return (Finding("info", f"{text}; for another, {typed}"),)


def unused_cameras(
    topics: Sequence[Topic], settings: TopicSettings, found: Mapping[str, Role]
) -> tuple[Finding, ...]:
    """Cameras besides the guessed one, or only unreadable ones, and what to type."""
    if not settings.cameras and "camera" not in found:
        unread = (topic for topic in topics if is_raw(topic) and messages.is_packets(topic))
        return tuple(
            Finding("warning", f"camera: {topic.name} holds {messages.PACKETS}") for topic in unread
        )
    if settings.cameras:
        return ()
    first_name = camera_name_of_source(found["camera"].path)
    others = [
        topic for topic in camera_topics(topics) if camera_name_of_source(topic) != first_name
    ]
    if not others:
        return ()
    first = found["camera"].path
    text = f"camera: {first} is used, {', '.join(others)} not; for more, type: [topics] camera = "
    return (Finding("info", text + json.dumps([first, *others])),)


def camera_topics(topics: Sequence[Topic]) -> list[str]:
    """Every topic that may be a camera's, in order; of topics that give a camera the same name, the
    first."""
    seen = [topic for topic in topics if is_raw(topic) and camera_rank(topic) is not None]
    ranked = sorted(topic.name for topic in seen)
    return sorted({camera_name_of_source(topic): topic for topic in reversed(ranked)}.values())


def find_unreadable_topics(topics: Sequence[Topic]) -> list[str]:
    """Why topics with broken definitions cannot have a role."""
    likely = [topic for topic in topics if any(rank(topic) is not None for rank in RANKS.values())]
    return [why for topic in likely if (why := problem_with_definition(topic)) is not None]
