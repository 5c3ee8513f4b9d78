"""The cameras that robot.toml names: topics or videos, and their names."""

import re
from pathlib import PurePath

from ..errors import ConfigError
from ..logs.formats import VIDEOS
from ..settings import TopicSettings

_PICTURE = re.compile(r"(/(image\w*|compressed|raw))+$", re.IGNORECASE)


def cameras_by_name(settings: TopicSettings) -> dict[str, str]:
    """The cameras in robot.toml: the first as "camera",
    others as "camera/NAME"; ConfigError for equal names.
    """
    found: dict[str, str] = {}
    for source in settings.cameras:
        name = camera_name_of_source(source)
        if name in found:
            both = f"{found[name]!r} and {source!r}"
            raise ConfigError(f"[topics] camera: {both} both get the name {name!r}; leave one out")
        found[name] = source
    return {
        f"camera/{name}" if rank else "camera": source
        for rank, (name, source) in enumerate(found.items())
    }


def camera_name_of_source(source: str) -> str:
    """A camera's name: its topic without generic words
    such as image, or its video's name without the suffix.
    """
    if is_video_source("camera", source):
        return PurePath(source).stem
    return _PICTURE.sub("", source).strip("/") or source.strip("/")


def is_video_source(role: str, source: str) -> bool:
    """Whether a camera setting names a video file."""
    return role == "camera" and source.lower().endswith(VIDEOS)
