"""What topics of joints are called, where robot.toml names several."""

import re

from ..errors import ConfigError

_STATES = re.compile(r"(/joint_?states?)+$", re.IGNORECASE)
JOINTS = "joints/"
"""What a delay of one topic's joints is called by, before the topic's name: delay = {"joints/head" = 0.02}."""


def topic_name(topic: str) -> str:
    """What a topic of joints is called: its name without what only says that it holds joint states."""
    return _STATES.sub("", topic).strip("/") or topic.strip("/")


def named(declared: str | tuple[str, ...] | None) -> dict[str, str]:
    """Roles of the topics robot.toml names for joints: joints, and joints/NAME for those beside the first."""
    found: dict[str, str] = {}
    for topic in (declared,) if isinstance(declared, str) else declared or ():
        name = topic_name(topic)
        if any(topic_name(other) == name for other in found.values()):
            raise ConfigError(f"[topics] joints: two topics would both be called {name!r}; leave one out")
        found[f"{JOINTS}{name}" if found else "joints"] = topic
    return found
