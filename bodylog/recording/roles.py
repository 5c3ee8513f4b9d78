"""Assign roles to topics: guessed from types, names and counts, or as in robot.toml."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from ..errors import BodylogError, ConfigError, LogError
from ..logs.decode.columns import definition_of
from ..logs.decode.definitions import PRIMITIVES, Definition
from ..logs.decode.dynamic import make_dynamic_reader
from ..logs.decode.message_path import parse_message_path
from ..logs.images import messages
from ..logs.records import Topic
from ..logs.topics import PREFIX, TRACK
from ..settings import TopicSettings
from .cameras import cameras_by_name, is_video_source

ROLES = ("joints", "camera", "skin", "truth", "reference")
_ANGLES = ("joints", "truth", "reference")
_FEWEST = 10
"""A further joint topic with fewer messages is not merged."""
_JOINTS = "sensor_msgs/msg/JointState"
_POSES = {
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "geometry_msgs/msg/TransformStamped": "transform",
    "nav_msgs/msg/Odometry": "pose.pose",
    "foxglove.PoseInFrame": "pose",
    "tf2_msgs/msg/TFMessage": "",
    "tf/msg/tfMessage": "",
}
"""The pose in messages of these types; tf has several, and a path tells which."""
_ARRAYS = ("std_msgs/msg/Float32MultiArray", "std_msgs/msg/Float64MultiArray")
_WISHED = re.compile(
    r"command|cmd|desired|target|goal|reference|setpoint|(^|/)actions?(/|$)", re.IGNORECASE
)
_TRUTH = re.compile(r"truth|(^|[/_])gt([/_]|$)", re.IGNORECASE)
_TOUCHED = re.compile(r"skin|tactile|touch|prox", re.IGNORECASE)
_COLOUR = re.compile(r"rgb|colou?r", re.IGNORECASE)
_DEPTH = re.compile(r"depth|disparity|mask|segment", re.IGNORECASE)
_GREY = re.compile(r"mono|gr[ae]y|infra|(^|[/_])ir([/_\d]|$)", re.IGNORECASE)
_STATES = re.compile(r"(/joint_?states?)+$", re.IGNORECASE)
JOINTS = "joints/"
"""Prefix of one joint topic's delay, before the topic's name: delay = {"joints/head" = 0.02}."""


class Role(NamedTuple):
    """One role's source: the topic (several records if it
    has several schemas) and the field, "" for the message.

    `unsure`: guessed from a generic type, so that its values must look like the role's.
    """

    role: str
    topic: str
    field: str
    topics: tuple[Topic, ...]
    unsure: bool = False

    @property
    def path(self) -> str:
        """The source as written in robot.toml."""
        return f"{self.topic}.{self.field}" if self.field else self.topic


def assign_roles(
    topics: Sequence[Topic],
    settings: TopicSettings,
    name: str,
    joints_of: Callable[[Topic], tuple[str, ...]] = lambda topic: (),
) -> dict[str, Role]:
    """Assign the roles that the topics can fill; LogError
    when robot.toml names a topic missing in the log `name`.

    A missing reference topic is allowed, as only logs to learn from have one; so are missing
    cameras if the log holds their tracks.

    `joints_of` gives the joints of a topic, to decide between several: the one with the most is the
    robot's, with those beside it whose joints differ.
    """
    found: dict[str, Role] = {}
    names = [topic.name for topic in topics]
    for role in ROLES:
        declared = _sources_declared(role, settings)
        known = {key: text for key, text in declared.items() if text}
        if role == "reference":
            there = [
                s for s in declared.values() if s and parse_message_path(s, names).topic in names
            ]
            found.update((role, _role_from_path(role, s, topics, name)) for s in there)
        elif not any(declared.values()):
            guessed = _guess_role(
                role, _main_joints(topics, joints_of) if role == "joints" else topics
            )
            found.update({role: guessed} if guessed else {})
            if role == "joints" and guessed:
                found.update(_further_joint_topics(guessed, topics, joints_of))
        elif role != "camera" or not _tracks_alone(topics):
            found.update(
                {
                    key: _role_from_path(role, s, topics, name)
                    for key, s in known.items()
                    if not is_video_source(role, s)
                }
            )
    return found


def _sources_declared(role: str, settings: TopicSettings) -> Mapping[str, str | None]:
    """The sources in robot.toml for a role: cameras and joints may have several."""
    if role == "camera":
        return cameras_by_name(settings)
    return (
        joint_topic_roles(settings.joints) if role == "joints" else {role: getattr(settings, role)}
    )


def _further_joint_topics(
    first: Role, topics: Sequence[Topic], joints_of: Callable[[Topic], tuple[str, ...]]
) -> dict[str, Role]:
    """Further joint topics, the most frequent first, without repeated joint names."""
    ranked = [
        (rank, t) for t in topics if is_raw(t) and (rank := joints_rank(t)) is not None and rank[0]
    ]
    if len({topic.name for _, topic in ranked}) < 2:
        return {}
    taken = {name for topic in first.topics for name in joints_of(topic)}
    found: dict[str, Role] = {}
    for _, topic in sorted(ranked, key=lambda pair: (*(-x for x in pair[0]), pair[1].name)):
        if (
            topic.name == first.topic
            or topic.messages < _FEWEST
            or problem_with_definition(topic) is not None
        ):
            continue
        names = {name for one in _topics_of_same_type(topics, topic) for name in joints_of(one)}
        if names and "" not in names | taken and not names & taken:
            found[f"joints/{topic_name(topic.name)}"] = Role(
                "joints", topic.name, "", _topics_of_same_type(topics, topic)
            )
            taken |= names
    return found


def _tracks_alone(topics: Sequence[Topic]) -> bool:
    """Whether a log carries tracks of an earlier run without the images."""
    return any(topic.name.startswith(TRACK) for topic in topics) and not any(
        camera_rank(topic) is not None for topic in topics
    )


def _main_joints(
    topics: Sequence[Topic], joints_of: Callable[[Topic], tuple[str, ...]]
) -> Sequence[Topic]:
    """Topics without joint states that are about as frequent as the best but name fewer joints."""
    ranks = {
        topic.name: rank
        for topic in topics
        if is_raw(topic) and (rank := joints_rank(topic)) is not None
    }
    most = max(ranks.values(), default=(0, 0))
    candidates = {name for name, rank in ranks.items() if rank >= (most[0], most[1] // 2)}
    if len(candidates) < 2:
        return topics
    joints = {
        name: max(len(joints_of(t)) for t in topics if t.name == name and t.type == _JOINTS)
        for name in candidates
    }
    fewer = {name for name in candidates if joints[name] < max(joints.values())}
    return [topic for topic in topics if topic.name not in fewer]


def is_command(topic: Topic) -> bool:
    """Whether a joint topic holds commands, by its name."""
    return _WISHED.search(topic.name) is not None


def is_raw(topic: Topic) -> bool:
    """Whether a topic holds messages that bodylog did not write."""
    return topic.messages > 0 and not topic.name.startswith(PREFIX)


def problem_with_definition(topic: Topic) -> str | None:
    """Why a topic's definition cannot be used, or None."""
    try:
        if topic.encoding == "protobuf":
            make_dynamic_reader(topic)
        elif topic.encoding != "json":
            definition_of(topic)
    except BodylogError as error:
        return str(error)
    return None


def _guess_role(role: str, topics: Sequence[Topic]) -> Role | None:
    ranked = [(RANKS[role](topic), topic) for topic in topics if is_raw(topic)]
    usable = [(rank, topic) for rank, topic in ranked if rank is not None]
    for _, topic in sorted(usable, key=lambda pair: (*(-x for x in pair[0]), pair[1].name)):
        field = _default_field(role, topic)
        if field is not None and problem_with_definition(topic) is None:
            unsure = role == "skin" and not (_TOUCHED.search(topic.name) or "Skin" in topic.type)
            return Role(role, topic.name, field, _topics_of_same_type(topics, topic), unsure)
    return None


def _topics_of_same_type(topics: Sequence[Topic], topic: Topic) -> tuple[Topic, ...]:
    return tuple(other for other in topics if other.name == topic.name and other.type == topic.type)


def _role_from_path(role: str, declared: str, topics: Sequence[Topic], name: str) -> Role:
    try:
        path = parse_message_path(declared, [topic.name for topic in topics])
    except ConfigError as problem:
        raise ConfigError(f"{name}: [topics] {role}: {problem}") from problem
    same = [topic for topic in topics if topic.name == path.topic]
    likely = [topic.name for topic in topics if RANKS[role](topic) is not None]
    others = [
        topic.name
        for topic in topics
        if topic.name != path.topic and not _is_mistaken_topic(role, topic)
    ]
    none = "none, the log has no other" if topics else "none, no topic of the log can be read"
    possible = f"possible: {', '.join(sorted(likely or others)[:10]) or none}"
    if not same:
        raise LogError(
            f'{name}: [topics] {role} = "{declared}", but there is no topic {path.topic!r}; '
            f"{possible}"
        )
    best = max(same, key=lambda topic: topic.messages)
    named = declared[len(path.topic) :].removeprefix(".")
    if not named and _is_mistaken_topic(role, best):
        what = best.type + (f" ({messages.PACKETS})" if messages.is_packets(best) else "")
        raise LogError(
            f'{name}: [topics] {role} = "{declared}", but {path.topic} is {what}; {possible}'
        )
    field = named or _default_field(role, best)
    if field is None and role == "joints" and best.type in _POSES:
        raise LogError(
            f"{name}: {declared} holds the poses of several frames; say which: [topics] joints = "
            f"'{path.topic}.transforms[:]{{child_frame_id==\"tool0\"}}.transform'"
        )
    if field is None:
        raise LogError(
            f"{name}: {declared} ({best.type}) has no array; say which: [topics] {role} = "
            f'"{declared}.field[:]"'
        )
    return Role(role, path.topic, field, _topics_of_same_type(topics, best))


def _is_mistaken_topic(role: str, topic: Topic) -> bool:
    """Whether the topic's type belongs to another role, or a camera's topic has no images."""
    if role != "camera" or topic.type == _JOINTS:
        return topic.type in (
            *messages.COMPRESSED,
            *messages.RAW,
            *(() if role in _ANGLES else (_JOINTS,)),
        )
    if (
        topic.type in messages.COMPRESSED + messages.RAW
        or topic.encoding in ("json", "protobuf")
        or problem_with_definition(topic)
    ):
        return messages.is_packets(topic)
    definition = definition_of(topic)
    return not {field.name for field in definition.types[definition.root]}.issuperset(
        messages.FIELDS
    )


def pose_field(topic: Topic) -> str | None:
    """The pose in a topic's messages, "" where a path must tell which; None without poses."""
    return _POSES.get(topic.type)


def joints_rank(topic: Topic) -> tuple[int, ...] | None:
    """How likely a topic holds the robot's joints; None if it cannot."""
    if topic.type != _JOINTS or _TRUTH.search(topic.name):
        return None
    return (not _WISHED.search(topic.name), topic.messages)


def _truth_rank(topic: Topic) -> tuple[int, ...] | None:
    return (topic.messages,) if topic.type == _JOINTS and _TRUTH.search(topic.name) else None


def camera_rank(topic: Topic) -> tuple[int, ...] | None:
    """How likely a topic shows the robot; None if it cannot."""
    if topic.type not in messages.COMPRESSED + messages.RAW or _DEPTH.search(topic.name):
        return None
    colour = bool(_COLOUR.search(topic.name))
    grey = bool(_GREY.search(topic.name))
    return (colour - grey, topic.messages, topic.type in messages.COMPRESSED)


def _skin_rank(topic: Topic) -> tuple[int, ...] | None:
    named = bool(_TOUCHED.search(topic.name))
    skin = "Skin" in topic.type
    if not (named or skin or topic.type in _ARRAYS) or topic.type in (
        _JOINTS,
        *messages.COMPRESSED,
        *messages.RAW,
    ):
        return None
    return (named, skin, not _WISHED.search(topic.name), topic.messages)


RANKS: Mapping[str, Callable[[Topic], tuple[int, ...] | None]] = {
    "joints": joints_rank,
    "truth": _truth_rank,
    "reference": _truth_rank,
    "camera": camera_rank,
    "skin": _skin_rank,
}


def _default_field(role: str, topic: Topic) -> str | None:
    """The field that a role reads by default: "" for
    whole messages, None if there is nothing to read.
    """
    if role == "camera" or topic.type == _JOINTS:
        return ""
    if role == "joints" and topic.type in _POSES:
        return pose_field(topic) or None
    if topic.encoding in ("json", "protobuf"):
        return None
    return array_field(definition_of(topic)) if problem_with_definition(topic) is None else None


def array_field(definition: Definition) -> str | None:
    """Path of the first array of numbers: `data`, or in an array of structs `data[:].prox[0]`."""
    fields = definition.types[definition.root]
    for wanted in ("f", "iu"):
        for field in fields:
            if field.size is not None and PRIMITIVES.get(field.type, "?")[0] in wanted:
                return field.name
        for field in fields:
            inner = definition.types.get(field.type, ()) if field.size is not None else ()
            arrays = [
                f for f in inner if f.size is not None and PRIMITIVES.get(f.type, "?")[0] in wanted
            ]
            single = [
                f for f in inner if f.size is None and PRIMITIVES.get(f.type, "?")[0] in wanted
            ]
            if arrays:
                return f"{field.name}[:].{arrays[0].name}[0]"
            if single and wanted == "f":
                return f"{field.name}[:].{single[0].name}"
    return None


def topic_name(topic: str) -> str:
    """A joint topic's name without generic words such as joint_states."""
    return _STATES.sub("", topic).strip("/") or topic.strip("/")


def joint_topic_roles(declared: str | tuple[str, ...] | None) -> dict[str, str]:
    """Roles of joint topics in robot.toml: joints, then joints/NAME for those after the first."""
    found: dict[str, str] = {}
    for topic in (declared,) if isinstance(declared, str) else declared or ():
        name = topic_name(topic)
        if any(topic_name(other) == name for other in found.values()):
            raise ConfigError(
                f"[topics] joints: two topics both get the name {name!r}; leave one out"
            )
        found[f"{JOINTS}{name}" if found else "joints"] = topic
    return found
