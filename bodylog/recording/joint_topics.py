"""Joints of several topics: which topics, their unique names, and their unit."""

from collections.abc import Mapping, Sequence

from ..settings import Settings
from .dated_streams import Stream
from .roles import topic_name


def streams_of(streams: Mapping[str, Stream]) -> list[Stream]:
    """The streams of joints, the main one first."""
    return [stream for stream in streams.values() if stream.role.role == "joints"]


def unconfigured_joints(streams: Mapping[str, Stream], settings: Settings) -> tuple[str, ...]:
    """Joints of further topics that were found without being configured."""
    found = streams_of(streams)
    guessed = settings.topics.joints is None
    return tuple(name for names in own_names(found)[1:] for name in names) if guessed else ()


def merged_joint_names(streams: Mapping[str, Stream]) -> tuple[str, ...]:
    """All joints, by their names in the merged signal."""
    return tuple(name for some in own_names(streams_of(streams)) for name in some)


def own_names(found: Sequence[Stream]) -> list[tuple[str, ...]]:
    """Each stream's joints; shared names begin with their topic's name: left/elbow, right/elbow."""
    counts: dict[str, int] = {}
    for stream in found:
        for name in stream.names:
            counts[name] = counts.get(name, 0) + 1
    return [
        tuple(f"{topic_name(s.role.topic)}/{n}" if counts[n] > 1 else n for n in s.names)
        for s in found
    ]


def unit_of_joints(streams: Mapping[str, Stream]) -> str | None:
    """The unit of the converted joints: rad, counts or unknown; None without joints."""
    found = streams_of(streams)
    return common_unit(found) if found else None


def common_unit(found: Sequence[Stream]) -> str:
    """The unit of the joints of one or more streams."""
    units = {stream.unit for stream in found}
    return units.pop() if len(units) == 1 else "unknown"
