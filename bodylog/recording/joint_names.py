"""The names of joint topics, if robot.toml lists several."""

import re

from ..errors import ConfigError

_STATES = re.compile(r"(/joint_?states?)+$", re.IGNORECASE)
JOINTS = "joints/"
"""Prefix of one joint topic's delay, before the topic's name: delay = {"joints/head" = 0.02}."""


def topic_name(topic: str) -> str:
    """A joint topic's name without generic words such as joint_states."""
    return _STATES.sub("", topic).strip("/") or topic.strip("/")


def joint_topic_roles(declared: str | tuple[str, ...] | None) -> dict[str, str]:
    """Roles of the joint topics in robot.toml: joints, and joints/NAME for those after the first."""
    found: dict[str, str] = {}
    for topic in (declared,) if isinstance(declared, str) else declared or ():
        name = topic_name(topic)
        if any(topic_name(other) == name for other in found.values()):
            raise ConfigError(
                f"[topics] joints: two topics both get the name {name!r}; leave one out"
            )
        found[f"{JOINTS}{name}" if found else "joints"] = topic
    return found
